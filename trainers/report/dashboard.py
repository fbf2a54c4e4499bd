"""A Weights & Biases workspace with our panels: runs in groups, over environment steps.

It needs the extra ``dashboard``. Building it asks no server; only saving needs an account.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..loggers import metrics
from .panels import CHANGES, FOLLOWED, LEARNING, SHARES, Panel

if TYPE_CHECKING:
    from wandb_workspaces.workspaces import Section, Workspace

GROUPS = {
    "Learning": LEARNING,
    "Rescues and regressions": CHANGES,
    "Controller and residual": SHARES,
}
WHOLE = {
    "quantities of the followed episodes": f"{metrics.EVALUATION}/[^/]+/metrics/",
    "the same of the controller alone": f"{metrics.EVALUATION}/[^/]+/controller_metrics/",
    "rewards while exploring": f"{metrics.TRAIN}/reward",
    "tests of the policies to hand over": f"{metrics.ACCEPTANCE}/",
    "losses and values": f"{metrics.LOSS}/",
    "steps changed by a safety limit": f"{metrics.SAFETY}/",
    "steps that an operator has taken over": f"{metrics.INTERVENTION}/",
    "prices of the budgets": f"{metrics.CONSTRAINT}/",
    "collection in wall-clock time": f"{metrics.REALTIME}/",
    "seconds of a round": f"{metrics.TIME}/",
}
"""Titles of the panels that show all metrics whose names begin so."""
MEDIA = ("media/video", "media/learning_curve")
TABLES = ("results/success", "results/episodes")


def build(entity: str, project: str = "rrl") -> Workspace:
    """Describe the workspace.

    Args:
        entity: W&B user or team.
        project: W&B project.

    Returns:
        The workspace; its ``save()`` sends it and needs ``wandb login``.

    Raises:
        ModuleNotFoundError: If the extra is missing.
    """
    try:
        import wandb_workspaces.reports.v2 as blocks
        import wandb_workspaces.workspaces as ws
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "the W&B dashboard needs an extra: pip install -e '.[dashboard]' in the clone"
        ) from error

    def section(title: str, panels: Sequence[Any], columns: int = 2, **settings: Any) -> Section:
        layout = ws.SectionLayoutSettings(columns=columns, rows=-(-len(panels) // columns))
        return ws.Section(name=title, panels=list(panels), layout_settings=layout, **settings)

    curves = [
        section(title, [blocks.LinePlot(**line_plot(panel)) for panel in panels], is_open=True)
        for title, panels in GROUPS.items()
    ]
    groups = [blocks.LinePlot(**_over_steps(name, f"^{start}")) for name, start in WHOLE.items()]
    shown = [
        blocks.MediaBrowser(title="videos and curves", media_keys=list(MEDIA)),
        *(blocks.WeavePanelSummaryTable(table_name=name) for name in TABLES),
    ]
    return ws.Workspace(
        entity=entity,
        project=project,
        name="Residual RL",
        sections=[
            *curves,
            section("Quantities", groups),
            section("Final evaluation", shown, columns=1, is_open=True),
            section("Configuration", [blocks.RunComparer()], columns=1),
        ],
        settings=ws.WorkspaceSettings(x_axis=metrics.STEP_AXIS, group_by_prefix="first"),
        runset_settings=ws.RunsetSettings(groupby=[ws.Metric("Group"), ws.Metric("JobType")]),
    )


def line_plot(panel: Panel) -> dict[str, Any]:
    """Return a panel as arguments of W&B's ``LinePlot``, drawn for every scenario.

    W&B draws what was logged: a panel in per cent is a share there.
    """
    names = "|".join(
        _pattern(name) for name in (panel.metric, panel.controller, panel.accepted) if name
    )
    return _over_steps(panel.title.replace(" [%]", ""), f"^({names})$")


def _over_steps(title: str, pattern: str) -> dict[str, Any]:
    return {
        "title": title,
        "x": metrics.STEP_AXIS,
        "metric_regex": pattern,
        "groupby_aggfunc": "mean",
        "groupby_rangefunc": "stderr",
    }


def _pattern(metric: str) -> str:
    return "[^/]+".join(re.escape(part) for part in metric.split(FOLLOWED))
