"""Where two models part: their difference by speed and lateral acceleration, with each one's error there."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.cross_validation.replay import Replay
from calibration.fitting.observations import UNITS
from qcar_twin.kinematics import road_speed
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

SPEEDS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, math.inf)  # m/s
LATERAL = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, math.inf)  # m/s^2
CHANNELS = ("motor_speed", "speed", "yaw_rate", "accel_y")
FEWEST = 30  # values in a cell that count
SHARE = 0.05  # of what is measured in a cell: the models part where they differ by more
QUIET = 0.3  # a cell with less in it than this share of the whole is judged against that share


@dataclasses.dataclass(frozen=True)
class Cell:
  """One region: root mean squares in the channel's unit.

  Attributes:
    speed, lateral: edges of the region, m/s and m/s^2.
    size: of what was measured there, at least QUIET of what was measured everywhere.
    difference: twin minus bicycle.  twin, bicycle: error of each.
  """

  channel: str
  speed: tuple[float, float]
  lateral: tuple[float, float]
  samples: int
  size: float
  difference: float
  twin: float
  bicycle: float

  @property
  def share(self) -> float:
    """Difference over the size of what was measured."""
    return self.difference / self.size if self.size > 0.0 else math.nan


@dataclasses.dataclass(frozen=True)
class ModelDifference:
  """Cells by channel; `by_speed` and `by_lateral` are summed over the other quantity."""

  grid: tuple[Cell, ...]
  by_speed: tuple[Cell, ...]
  by_lateral: tuple[Cell, ...]

  def document(self) -> dict[str, Any]:
    """Plain types for JSON."""
    return {f.name: [dataclasses.asdict(c) for c in getattr(self, f.name)] for f in dataclasses.fields(self)}

  def sentences(self) -> list[str]:
    """Where the models part by more than SHARE, in words, one sentence a channel."""
    return [s for c in CHANNELS for s in _sentence(c, self.by_speed, self.by_lateral)]


def compare_by_region(replay: Replay, recordings: Sequence[Recording], vehicle: Vehicle) -> ModelDifference:
  """Sort every value of a replay by the measured speed and lateral acceleration (v r) at its time."""
  observations = replay.observations
  speed, lateral = _state(observations, recordings, vehicle)
  cells: dict[str, list[Cell]] = {"grid": [], "by_speed": [], "by_lateral": []}
  everything = (0.0, math.inf)
  for channel in CHANNELS:
    if channel not in observations.present:
      continue
    rows = observations.select(channel) & np.isfinite(speed) & np.isfinite(lateral)
    for kind, speeds, laterals in (
      ("grid", SPEEDS, LATERAL),
      ("by_speed", SPEEDS, everything),
      ("by_lateral", everything, LATERAL),
    ):
      cells[kind] += _cells(replay, channel, rows, speed, lateral, speeds, laterals)
  return ModelDifference(*(tuple(cells[kind]) for kind in ("grid", "by_speed", "by_lateral")))


def _cells(
  replay: Replay,
  channel: str,
  rows: NDArray[np.bool_],
  speed: Array,
  lateral: Array,
  speeds: Sequence[float],
  laterals: Sequence[float],
) -> list[Cell]:
  cells = []
  measured, twin, bicycle = replay.observations.measured, replay.predicted["twin"], replay.predicted["bicycle"]
  least = QUIET * _root_mean_square(measured[rows])
  for low, high in zip(speeds[:-1], speeds[1:], strict=True):
    for left, right in zip(laterals[:-1], laterals[1:], strict=True):
      here = rows & (speed >= low) & (speed < high) & (lateral >= left) & (lateral < right)
      if here.sum() >= FEWEST:
        errors = [twin[here] - bicycle[here], twin[here] - measured[here], bicycle[here] - measured[here]]
        size = max(_root_mean_square(measured[here]), least)
        values = [_root_mean_square(e) for e in errors]
        cells.append(Cell(channel, (low, high), (left, right), int(here.sum()), size, *values))
  return cells


def _root_mean_square(values: Array) -> float:
  return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def _state(observations, recordings: Sequence[Recording], vehicle: Vehicle) -> tuple[Array, Array]:
  """Measured speed [m/s] and size of lateral acceleration v r [m/s^2] at every value's time, (M,); without a gyro
  the accelerometer's, without either zero."""
  speed, lateral = np.full((2, len(observations)), np.nan)
  for index, recording in enumerate(recordings):
    rows = observations.recording == index
    time = observations.time[rows]
    if "motor_speed" in recording:
      speed[rows] = np.abs(road_speed(_at(recording, "motor_speed", time), vehicle))
    elif "speed" in recording:
      speed[rows] = np.abs(_at(recording, "speed", time))
    if "yaw_rate" in recording:
      lateral[rows] = np.abs(_at(recording, "yaw_rate", time)) * speed[rows]
    else:
      lateral[rows] = np.abs(_at(recording, "accel_y", time)) if "accel_y" in recording else 0.0
  return speed, lateral


def _at(recording: Recording, channel: str, time: Array) -> Array:
  stream = recording[channel]
  return np.interp(time, stream.time, stream.value)


def _sentence(channel: str, by_speed: Sequence[Cell], by_lateral: Sequence[Cell]) -> list[str]:
  sentences = []
  for cells, edge, unit in ((by_lateral, "lateral", "m/s² of lateral acceleration"), (by_speed, "speed", "m/s")):
    own = [c for c in cells if c.channel == channel]
    apart = [c for c in own if c.share > SHARE]
    if not apart:
      continue
    worst = max(apart, key=lambda c: c.share)
    low, high = getattr(worst, edge)
    where = f"above {low:g} {unit}" if math.isinf(high) else f"between {low:g} and {high:g} {unit}"
    better = "twin" if worst.twin < worst.bicycle else "bicycle"
    sentences.append(
      f"{_name(channel)}: most {where}, by {worst.difference:.2g} {UNITS[channel]}"
      f" ({100 * worst.share:.0f} % of what is measured there); there the {better} is nearer to the recordings"
      f" (errors: twin {worst.twin:.2g}, bicycle {worst.bicycle:.2g})"
    )
  return sentences


def _name(channel: str) -> str:
  return channel.replace("_", " ").replace("accel y", "lateral acceleration").capitalize()
