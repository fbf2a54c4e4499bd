// Draws every chart from the JSON beside it, in the colours of the reader's light or dark theme.
(() => {
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const charts = [...document.querySelectorAll(".chart")].map((div) => {
    const figure = JSON.parse(div.nextElementSibling.textContent);
    div.style.minHeight = (figure.layout.height || 420) + "px";
    return { div, figure };
  });
  const colours = () => {
    const style = getComputedStyle(document.documentElement);
    return (name) => style.getPropertyValue(name).trim();
  };
  const themed = (layout) => {
    const colour = colours();
    const out = { ...layout, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)" };
    out.font = { ...layout.font, color: colour("--ink") };
    out.hoverlabel = { ...layout.hoverlabel, bgcolor: colour("--panel"), font: { color: colour("--ink") } };
    for (const key of Object.keys(layout).filter((k) => /^[xy]axis\d*$/.test(k))) {
      out[key] = { ...layout[key], gridcolor: colour("--line"), zerolinecolor: colour("--line"), linecolor: colour("--line") };
    }
    return out;
  };
  const options = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
  const draw = ({ div, figure }) => Plotly.react(div, figure.data, themed(figure.layout), options);
  charts.forEach(draw);
  dark.addEventListener("change", () => charts.forEach(draw));
})();
