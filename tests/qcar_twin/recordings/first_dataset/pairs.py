"""A drive as two files: what the car logged, and what motion capture saw, each by its own clock."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.formats import read_table
from tests.qcar_twin.recordings.drives import write_csv

Array = NDArray[np.float64]
POSE = ("pose_x", "pose_y", "pose_yaw")
NOT_LOGGED = (*POSE, "pose_score")


def sample_columns(path: Path) -> tuple[Array, dict[str, Array]]:
  """Time and columns of a recording."""
  columns = dict(read_table(path).columns)
  return columns.pop("time"), columns


def write_pair(folder: Path, name: str, time: Array, columns: dict[str, Array], shift=0.0, capture="{}_mocap") -> None:
  """`name.csv` and `name_mocap.csv`; `shift`: s that the capture's clock is ahead."""
  folder.mkdir(exist_ok=True)
  write_csv(folder / f"{name}.csv", time, {k: v for k, v in columns.items() if k not in NOT_LOGGED})
  seen = np.arange(time[0] + 0.05, time[-1] - 0.05, 0.01)
  known = np.isfinite(columns["pose_x"])
  poses = {k: np.unwrap(columns[k][known]) if k == "pose_yaw" else columns[k][known] for k in POSE}
  own = {k.removeprefix("pose_"): np.interp(seen, time[known], v) for k, v in poses.items()}
  write_csv(folder / f"{capture.format(name)}.csv", seen + shift, own)
