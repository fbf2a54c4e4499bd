// Draws every chart from the JSON beside it, in the colors of the reader's light or dark theme. Traces may carry
// meta: {"Run": "name", "Show": "seed 3"}; one bar of check boxes then switches all traces of a kind in all charts.
(() => {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const options = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
  const charts = [...document.querySelectorAll(".chart")].map((div) => {
    const figure = JSON.parse(div.nextElementSibling.textContent);
    div.style.height = (figure.layout.height || 420) + "px";
    return { div, figure };
  });
  const off = new Set(); // "key: value" of the boxes that are not checked

  function template() {
    const style = getComputedStyle(document.documentElement);
    const [ink, soft, line, panel] = ["--ink", "--soft", "--line", "--panel"].map((n) => style.getPropertyValue(n).trim());
    const axis = { gridcolor: line, zerolinecolor: line, linecolor: line, automargin: true };
    return { layout: {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", xaxis: axis, yaxis: axis,
      colorway: ["#2f7fc1", "#d9622b", "#3a9d6a", "#9467bd", "#c59a1a", "#c2508b", "#4fa3a5", "#8c6d5a"],
      font: { color: ink, family: "system-ui, sans-serif", size: 13 }, margin: { l: 56, r: 16, t: 40, b: 48 },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: soft, activecolor: ink },
      hoverlabel: { bgcolor: panel, bordercolor: line, font: { color: ink } },
    } };
  }

  function draw() {
    for (const { div, figure } of charts) {
      const data = figure.data.map((trace) => {
        const hidden = Object.entries(trace.meta || {}).some(([key, value]) => off.has(`${key}: ${value}`));
        return hidden ? { ...trace, visible: false } : trace;
      });
      Plotly.react(div, data, { ...figure.layout, template: template() }, options);
    }
  }

  function choices() {
    const found = new Map();
    for (const trace of charts.flatMap(({ figure }) => figure.data)) {
      for (const [key, value] of Object.entries(trace.meta || {})) {
        found.set(key, (found.get(key) || new Set()).add(value));
      }
    }
    return [...found].filter(([, values]) => values.size > 1);
  }

  function addBar() {
    if (!choices().length) return;
    const bar = document.createElement("form");
    bar.className = "choices";
    for (const [key, values] of choices()) {
      const group = bar.appendChild(document.createElement("fieldset"));
      group.appendChild(document.createElement("legend")).textContent = key;
      for (const value of values) {
        const label = group.appendChild(document.createElement("label"));
        const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: true });
        box.addEventListener("change", () => { off[box.checked ? "delete" : "add"](`${key}: ${value}`); draw(); });
        label.append(box, value);
      }
    }
    charts[0].div.closest("figure").before(bar);
  }

  addBar();
  draw();
  dark.addEventListener("change", draw);
})();
