"""Key performance indicators of path tracking: ME, RMSE, IACA (the paper's eqs. KPI_def), and the borders."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from agents.control.closed_loop import Drive
from qcar_twin.plant import POSE, STEERING

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Kpis:
  """Of N runs, (N,) each.

  Attributes:
    me: largest absolute cross-track error, m.
    rmse: its root mean square over time, m.
    iaca: mean absolute steering command, rad.
    steering_rate: root mean square rate of the steering command, rad/s.
    finished: reached the end of the path.
    inside: stayed between the borders; true where there are none.
  """

  me: Array
  rmse: Array
  iaca: Array
  steering_rate: Array
  finished: NDArray[np.bool_]
  inside: NDArray[np.bool_]


def kpis(drive: Drive) -> Kpis:
  """KPIs from the true poses, each run up to its own end. A run that left the path has infinite ME and RMSE."""
  under_way = drive.under_way  # (T, N)
  steps = np.maximum(under_way.sum(axis=0), 1)
  error = np.where(under_way, drive.cross_track, 0.0)
  command = drive.commands[..., STEERING]
  steering = np.where(under_way, command, 0.0)
  rate = np.diff(command, axis=0, prepend=command[:1]) / drive.period
  rate = np.where(under_way, rate, 0.0)
  lost = ~drive.finished
  me = np.where(lost, np.inf, np.max(np.abs(error), axis=0))
  rmse = np.where(lost, np.inf, np.sqrt(np.sum(error**2, axis=0) / steps))
  kept = drive.path.inside_lanes(*np.moveaxis(drive.signals[..., POSE], -1, 0))
  inside = np.all(np.logical_or(~under_way, kept), axis=0)
  iaca = np.sum(np.abs(steering), axis=0) / steps
  return Kpis(me, rmse, iaca, np.sqrt(np.sum(rate**2, axis=0) / steps), drive.finished, inside & drive.finished)
