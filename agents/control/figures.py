"""Figures of path tracking, like the paper's: path, cross-track error over distance, indicators."""

from collections.abc import Mapping, Sequence
from pathlib import Path as File
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from agents.control.closed_loop import Drive
from qcar_twin.paths import CAR_LENGTH, CAR_WIDTH, Path
from qcar_twin.plant import POSE, POSITION
from qcar_twin.plotting import PATH, contestant_colour, house, new_figure, save

LINES = {"loose": "--", "tuned": "-"}


def draw_path(axes: Axes, path: Path) -> None:
  """Reference, dashed black, with the borders of its lanes."""
  axes.plot(path.x, path.y, color=PATH, ls="--", lw=1.0, label="reference")
  for lane in path.lanes:
    for side in (lane.left, lane.right):
      axes.plot([lane.start, lane.end], [side, side], color=PATH, lw=2.0)
  axes.set_aspect("equal")
  axes.set_xlabel("X [m]")
  axes.set_ylabel("Y [m]")


@house()
def tracking_figure(drives: Mapping[str, Drive], file: File, car: int = 0) -> None:
  """Driven paths and cross-track errors of one car of each drive on one path."""
  path = next(iter(drives.values())).path
  figure, ((left, right),) = new_figure(1, 2, width=12.0, row_height=4.1)
  draw_path(left, path)
  for name, drive in drives.items():
    until = drive.under_way[:, car]
    style: dict[str, Any] = {"color": contestant_colour(name), "ls": LINES.get(name.split()[-1], "-"), "lw": 1.0}
    left.plot(*drive.signals[until, car, POSITION].T, label=name, **style)
    right.plot(drive.arc_length[until, car], 1e3 * drive.cross_track[until, car], **style)
  right.axhline(0.0, color=PATH, lw=0.5)
  right.set_xlabel("travelled distance s [m]")
  right.set_ylabel("cross-track error [mm]")
  left.legend(fontsize=7)
  save(figure, file)


@house()
def lane_change_figure(drives: Mapping[str, Drive], file: File, car: int = 0) -> None:
  """The double lane change alone; of one or two drives also the paths of the car's corners, against the borders."""
  path = next(iter(drives.values())).path
  figure, ((axes,),) = new_figure(width=10.0, row_height=3.8)
  draw_path(axes, path)
  for name, drive in drives.items():
    until = drive.under_way[:, car]
    x, y, yaw = drive.signals[until, car, POSE].T
    for forward, left in ((0.5, 0.5), (0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)) if len(drives) <= 2 else ():
      a, b = forward * CAR_LENGTH, left * CAR_WIDTH
      corner = x + a * np.cos(yaw) - b * np.sin(yaw), y + a * np.sin(yaw) + b * np.cos(yaw)
      axes.plot(*corner, color=contestant_colour(name), lw=0.5)
    axes.plot(x, y, color=contestant_colour(name), ls=LINES.get(name.split()[-1], "-"), lw=1.2, label=name)
  first, last = path.lanes[0], path.lanes[-1]
  axes.set_xlim(first.start - 0.3, last.end + 0.3)
  axes.set_ylim(first.right - 0.15, path.lanes[1].left + 0.15)
  axes.set_aspect("auto")
  axes.legend(fontsize=7, ncols=5, loc="upper center", bbox_to_anchor=(0.5, -0.18))
  save(figure, file)


@house()
def indicator_figure(table: Mapping[str, Mapping[str, Sequence[float]]], file: File) -> None:
  """RMSE, ME and IACA bars: path -> controller -> (rmse m, me m, iaca rad)."""
  figure, (parts,) = new_figure(1, 3, width=12.0, row_height=3.2)
  titles = ("RMSE [mm]", "ME [mm]", "IACA [deg]")
  scales = (1e3, 1e3, float(np.degrees(1.0)))
  names = list(next(iter(table.values())))
  for i, (axes, title, scale) in enumerate(zip(parts, titles, scales, strict=True)):
    for j, name in enumerate(names):
      heights = [scale * table[path][name][i] for path in table]
      place = np.arange(len(table)) + 0.8 * j / len(names)
      hatch = "//" if name.endswith("loose") else None
      axes.bar(place, heights, 0.8 / len(names), color=contestant_colour(name), hatch=hatch, edgecolor="w", label=name)
    axes.set_xticks(np.arange(len(table)) + 0.35, list(table))
    axes.set_title(title)
  parts[0].legend(fontsize=6)
  save(figure, file)
