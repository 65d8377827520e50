"""The picture of the circle script, car, log, twin, script: drives of the car and of its twins, one over the other.

The folders are data sets that `qcar-twin drive --record` wrote (docs/guide/onboard.md):

  python -m docs.make.circle out/car out/before out/after out/again
"""

import functools
import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from qcar_twin import plotting
from qcar_twin.onboard.recorder import drive_of
from qcar_twin.recordings.dataset import DataSet

FILE = Path(__file__).parents[1] / "pictures" / "circle.png"
OPEN_LOOP, CLOSED_LOOP = "steps", "waypoints"  # scripts of tests/qcar_twin/onboard/scripts
SHOWN = (25.4, 27.4)  # s of the steps: to the left, then to the right
LABELS = ("the car", "twin before the diagnosis", "twin after it")
Array = NDArray[np.float64]


_set = functools.cache(DataSet.load)


def channel(folder: Path, script: str, name: str) -> tuple[Array, Array]:
  """Time [s] and samples of a channel over all parts of a script's drive."""
  parts = [r[name] for r in _set(folder).recordings if drive_of(r.name.partition("#")[0]) == script]
  time, value = (np.concatenate([getattr(part, which) for part in parts]) for which in ("time", "value"))
  order = np.argsort(time)
  return time[order], value[order]


def path_of(folder: Path) -> tuple[Array, Array]:
  """Time [s] and position (T, 2) [m] in the closed loop."""
  (time, x), (other, y) = (channel(folder, CLOSED_LOOP, f"pose_{axis}") for axis in "xy")
  return time, median_filter(np.column_stack([x, np.interp(time, other, y)]), (5, 1))  # single poses are wrong


def draw(car: Path, before: Path, after: Path, again: Path) -> None:
  """Yaw rate of the open loop above; the closed loop's path and its distance from the car's below.

  Args:
    again: the car once more, with other noise.
  """
  figure, _ = plotting.new_figure(2, 1, width=8.6, row_height=2.3)
  figure.clear()
  with plotting.house():
    grid = figure.add_gridspec(2, 2, width_ratios=(1.3, 1.0))
    above, left, right = (figure.add_subplot(grid[place]) for place in ((0, slice(None)), (1, 0), (1, 1)))
    for who, folder, label in zip(("measured", "before", "twin"), (car, before, after), LABELS, strict=True):
      time, rate = channel(folder, OPEN_LOOP, "yaw_rate")
      shown = (time >= SHOWN[0]) & (time <= SHOWN[1])
      plotting.draw(above, time[shown], rate[shown], who, label)
      _, place = path_of(folder)
      plotting.draw(left, place[:, 0], place[:, 1], who, label)
    gaps(right, car, {"measured": again, "before": before, "twin": after})
    left.set_aspect("equal", adjustable="datalim")
    above.set(title=f"{OPEN_LOOP}.py, open loop", xlabel="time, s", ylabel="yaw rate, rad/s")
    left.set(title=f"{CLOSED_LOOP}.py, closed loop", xlabel="x, m", ylabel="y, m")
    right.set(
      title="distance from the car (black: itself, driven again)", xlabel="time, s", ylabel="m", ylim=(0.0, None)
    )
    above.legend(loc="lower left", bbox_to_anchor=(0.3, 0.05))
    plotting.save(figure, FILE)


def gaps(axes: Axes, car: Path, others: dict[str, Path]) -> None:
  """Distance from the car at the same time."""
  time, place = path_of(car)
  for who, folder in others.items():
    clock, theirs = path_of(folder)
    off = np.column_stack([np.interp(time, clock, theirs[:, k]) for k in range(2)]) - place
    plotting.draw(axes, time, np.hypot(*off.T), who)


if __name__ == "__main__":
  draw(*map(Path, sys.argv[1:5]))
