"""The one table of colours, and the house's matplotlib settings: the same in plots, reports and videos."""

import os
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from qcar_twin.atomic_io import whole_file

MEASURED = "#000000"
TWIN = "#1f6fb4"
BICYCLE = "#e07b1a"
BEFORE = "#c8553d"
NOISE = "#dedede"  # shaded
EVIDENCE = "#f3d9a4"  # background of the seconds that carry evidence
RULE = "#d5d5d5"  # thin lines between recordings
NOTE = "#7a7a7a"  # small print inside a figure
PATH = "#1a1a1a"  # to be followed
BORDER = "#d9261a"  # of its lanes
GHOST = "#ff7300"  # a second car in a video, translucent
CONTESTANTS = {  # controllers by the first part of their label, variants of the learning study
  "ff_fb": "#1f77b4",
  "lq_ed": "#d62728",
  "lq_cm": "#daa520",
  "linear_rate": "#9467bd",
  "ddpg": "#2ca02c",
  "paper": "#2ca02c",
  "ppo": "#e6194b",
  "sac": "#808000",
  "td3": "#000075",
  "imitation": "#17becf",
  "standard": "#2ca02c",
  "alone": "#bcbd22",
  "wide": "#17becf",
  "recalibrated": "#8c564b",
  "repaired": "#e377c2",
}
PALETTE = {  # of interactive pages, by name: on light, on dark
  "ink": ("#1a1a1a", "#e9e9e6"),
  "paper": ("#ffffff", "#16181b"),
  "soft": ("#5b5b5b", "#a9abad"),
  "note": (NOTE, "#8f9296"),
  "rule": ("#dcdcdc", "#3a3d42"),
  "grid": ("#e8e8e8", "#2c2f34"),
  "raised": ("#f4f7fa", "#1f2329"),
  "measured": (MEASURED, "#f4f4f0"),
  "twin": (TWIN, "#5fb0f2"),
  "bicycle": (BICYCLE, "#ffa856"),
  "before": (BEFORE, "#ff8a70"),
  "nominal": ("#8a8a8a", "#8f9296"),
  "noise": (NOISE, "#3a3d42"),
  "evidence": (EVIDENCE, "#5a4a24"),
  "good": ("#2e7d4f", "#5cc98a"),
  "partly": ("#b7791f", "#e8b04a"),
  "bad": ("#b3261e", "#ff8a80"),
}
HEAT = (("#e6e3da", "#f2b45c", "#b30019"), ("#3b3f45", "#c77a22", "#ffe08a"))  # little to much: on light, on dark
COLOURS = {"measured": MEASURED, "twin": TWIN, "bicycle": BICYCLE, "before": BEFORE, "noise floor": NOISE}

_RC: dict[Any, Any] = {
  "font.size": 9.0,
  "axes.titlesize": 9.5,
  "axes.spines.top": False,
  "axes.spines.right": False,
  "axes.grid": True,
  "grid.color": "#e8e8e8",
  "grid.linewidth": 0.6,
  "lines.linewidth": 1.2,
  "legend.frameon": False,
  "xtick.labelsize": 8.0,
  "ytick.labelsize": 8.0,
  "legend.fontsize": 8.5,
  "svg.hashsalt": "qcar-twin",
}


def house() -> Any:
  """The house's matplotlib settings, for a with statement or as a decorator of a function that draws."""
  return mpl.rc_context(_RC)


def new_figure(
  rows: int = 1, columns: int = 1, width: float = 8.0, row_height: float = 2.1, share_x: bool = False
) -> tuple[Figure, Any]:
  """A figure without global state, and its axes, (rows, columns). Titles and legends made later want `house` too.

  Args:
    width, row_height: inches.
    share_x: one horizontal axis for all rows.
  """
  with house():
    figure = Figure(figsize=(width, row_height * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=share_x)
  return figure, axes


def save(figure: Figure, path: str | os.PathLike[str], dpi: int = 110) -> None:
  """Write a figure as PNG, whole or not at all."""
  with house(), whole_file(path) as part:
    figure.savefig(part, format="png", dpi=dpi)


def contestant_colour(label: str) -> str:
  """Colour of a controller, "lq_cm tuned", or of a variant of the learning study, "wide"."""
  return CONTESTANTS.get(label.split()[0], NOTE)


def draw(axes: Axes, time: ArrayLike, value: ArrayLike, who: str, label: str = "") -> None:
  """A line in the colour of "measured", "twin", "bicycle" or "before"; its name is the label unless given."""
  width = 0.9 if who == "measured" else 1.3
  axes.plot(time, value, color=COLOURS[who], linewidth=width, label=label or who, zorder=1 if who == "measured" else 2)
