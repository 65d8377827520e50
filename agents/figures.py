"""Figures of path tracking, like the paper's: path, cross-track error over distance, indicators."""

from collections.abc import Mapping, Sequence
from pathlib import Path as File

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from agents.closed_loop import Drive
from qcar_twin.paths import CAR_LENGTH, CAR_WIDTH, Path
from qcar_twin.whole_file import whole_file

COLOURS = {
  "ff_fb": "tab:blue",
  "lq_ed": "tab:red",
  "lq_cm": "goldenrod",
  "linear_rate": "tab:purple",
  "ddpg": "tab:green",
}
LINES = {"loose": "--", "tuned": "-"}


def colour(name: str) -> str:
  """The colour of a controller, by the first part of its label."""
  return COLOURS.get(name.split()[0], "tab:gray")


def draw_path(axes: Axes, path: Path) -> None:
  """Reference, dashed black, with the borders of its lanes."""
  axes.plot(path.x, path.y, "k--", lw=1.0, label="reference")
  for lane in path.lanes:
    for side in (lane.left, lane.right):
      axes.plot([lane.start, lane.end], [side, side], color="k", lw=2.0)
  axes.set_aspect("equal")
  axes.set_xlabel("X [m]")
  axes.set_ylabel("Y [m]")


def tracking_figure(drives: Mapping[str, Drive], file: File, car: int = 0) -> None:
  """Driven paths and cross-track errors of one car of each drive on one path."""
  path = next(iter(drives.values())).path
  figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.5), layout="constrained")
  draw_path(left, path)
  for name, drive in drives.items():
    until = drive.under_way[:, car]
    style = LINES.get(name.split()[-1], "-")
    left.plot(*drive.signals[until, car, :2].T, color=colour(name), ls=style, lw=1.0, label=name)
    right.plot(drive.arc_length[until, car], 1e3 * drive.cross_track[until, car], color=colour(name), ls=style, lw=1.0)
  right.axhline(0.0, color="k", lw=0.5)
  right.set_xlabel("travelled distance s [m]")
  right.set_ylabel("cross-track error [mm]")
  left.legend(fontsize=7)
  _save(figure, file)


def lane_change_figure(drives: Mapping[str, Drive], file: File, car: int = 0) -> None:
  """The double lane change alone; of one or two drives also the paths of the car's corners, against the borders."""
  path = next(iter(drives.values())).path
  figure, axes = plt.subplots(figsize=(10, 4.2), layout="constrained")
  draw_path(axes, path)
  for name, drive in drives.items():
    until = drive.under_way[:, car]
    x, y, yaw = drive.signals[until, car, :3].T
    for forward, left in ((0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)) if len(drives) <= 2 else ():
      a, b = forward * CAR_LENGTH, left * CAR_WIDTH
      corner = x + a * np.cos(yaw) - b * np.sin(yaw), y + a * np.sin(yaw) + b * np.cos(yaw)
      axes.plot(*corner, color=colour(name), lw=0.5)
    axes.plot(x, y, color=colour(name), ls=LINES.get(name.split()[-1], "-"), lw=1.2, label=name)
  first, last = path.lanes[0], path.lanes[-1]
  axes.set_xlim(first.start - 0.3, last.end + 0.3)
  axes.set_ylim(first.right - 0.15, path.lanes[1].left + 0.15)
  axes.set_aspect("auto")
  axes.legend(fontsize=7, ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.18))
  _save(figure, file)


def indicator_figure(table: Mapping[str, Mapping[str, Sequence[float]]], file: File) -> None:
  """RMSE, ME and IACA bars: path -> controller -> (rmse m, me m, iaca rad)."""
  figure, parts = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
  titles = ("RMSE [mm]", "ME [mm]", "IACA [deg]")
  scales = (1e3, 1e3, float(np.degrees(1.0)))
  names = list(next(iter(table.values())))
  for i, (axes, title, scale) in enumerate(zip(parts, titles, scales, strict=True)):
    for j, name in enumerate(names):
      heights = [scale * table[path][name][i] for path in table]
      place = np.arange(len(table)) + 0.8 * j / len(names)
      hatch = "//" if name.endswith("loose") else None
      axes.bar(place, heights, 0.8 / len(names), color=colour(name), hatch=hatch, edgecolor="w", label=name)
    axes.set_xticks(np.arange(len(table)) + 0.35, list(table))
    axes.set_title(title)
  parts[0].legend(fontsize=6)
  _save(figure, file)


def trace_figure(drive: Drive, file: File, car: int = 0) -> None:
  """Speed, steering, voltage and the error of the estimated position of one car over time."""
  figure, parts = plt.subplots(4, 1, figsize=(9, 8), sharex=True, layout="constrained")
  time, until = drive.time, drive.under_way[:, car]
  series = (
    ("speed [m/s]", np.hypot(*drive.signals[:, car, 3:5].T)),
    ("steering command [deg]", np.degrees(drive.commands[:, car, 1])),
    ("motor voltage [V]", drive.commands[:, car, 0]),
    ("error of estimated position [mm]", 1e3 * np.hypot(*(drive.pose[:, car, :2] - drive.signals[:, car, :2]).T)),
  )
  for axes, (label, values) in zip(parts, series, strict=True):
    axes.plot(time[until], values[until], color="tab:blue", lw=0.9)
    axes.set_ylabel(label, fontsize=8)
  parts[-1].set_xlabel("time [s]")
  _save(figure, file)


def _save(figure: plt.Figure, file: File) -> None:
  with whole_file(file) as part:
    figure.savefig(part, dpi=110)
  plt.close(figure)
