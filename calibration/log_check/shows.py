"""Which physics this driving can show: what was excited, and for how long."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.noise import standstill_seconds
from calibration.log_check.motions import Wheels
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import GRAVITY, Vehicle

Array = NDArray[np.float64]
_PERIOD = 0.02  # s
_LEAST = 3.0  # s of a kind of driving, or times that something happened, below which it is called little
_MOVES = 0.05  # of the largest speed, above which the car drives


@dataclasses.dataclass(frozen=True)
class Shown:
  """One kind of driving: what it takes to tell `physics`, how much of it there is, and in what unit."""

  physics: str
  takes: str
  amount: float
  unit: str

  @property
  def verdict(self) -> str:
    return "none" if self.amount <= 0.0 else "little" if self.amount < _LEAST else "enough"


@dataclasses.dataclass(frozen=True)
class Driven:
  """All recordings on one grid, end to end.

  Attributes:
    speed: m/s.  change: of it, m/s^2.  steering: commanded, rad.  turned: its rate, rad/s.
    command: of the drive.  across: acceleration, m/s^2.  first: where a recording begins.
  """

  speed: Array
  change: Array
  steering: Array
  turned: Array
  command: Array
  across: Array
  first: NDArray[np.bool_]

  @classmethod
  def of(cls, wheels: Wheels, wheelbase: float, recordings: Sequence[Recording]) -> "Driven":
    parts = [p for r in recordings if wheels.channel in r for p in [_driven(r, wheels, wheelbase)]]
    return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

  @property
  def top(self) -> float:
    """The speed that 99 of 100 samples stay below, m/s."""
    return float(np.percentile(np.abs(self.speed), 99.0))


def what_it_shows(vehicle: Vehicle, wheels: Wheels, recordings: Sequence[Recording]) -> list[Shown]:
  """Kinds of driving and the physics that need them; what no recording holds is in the list, too."""
  d = Driven.of(wheels, vehicle.cg_to_front + vehicle.cg_to_rear, recordings)
  seconds = lambda rows: float(np.sum(rows)) * _PERIOD
  times = lambda rows: float(np.sum(rows[1:] & ~rows[:-1] & ~d.first[1:]))
  moving, lock = np.abs(d.speed) > _MOVES * d.top, vehicle.max_steering
  straight = np.abs(d.steering) < 0.1 * lock
  largest = np.percentile(np.abs(d.command), 99.0)
  sides = min(seconds(moving & (sign * d.steering > 0.3 * lock)) for sign in (1.0, -1.0))
  rows = [
    ("drive map", "straight driving at many commands", seconds(moving & straight & (d.command != 0.0)), "s"),
    ("resistance", "rolling out straight with nothing commanded", seconds(moving & straight & (d.command == 0.0)), "s"),
    ("breakaway, play, sag of the supply", "starts from rest", times(moving), "starts"),
    ("reverse", "driving backwards", seconds(d.speed < -_MOVES * d.top), "s"),
    ("drive at its limits", "nine tenths of the largest command", seconds(np.abs(d.command) > 0.9 * largest), "s"),
    ("braking", "a command against the motion", seconds(moving & (d.command * d.speed < 0.0)), "s"),
    ("steering map on both sides", "a third of the lock and more, to the weaker side", sides, "s"),
    ("play and asymmetry of the steering", "changes of side", times(d.steering > 0.0), "changes"),
    ("lag of servo and tyres", "a lock's worth of steering in a second or less", seconds(d.turned > lock), "s"),
    ("tyres beyond their linear range", "half of gravity across", seconds(np.abs(d.across) > 0.5 * GRAVITY), "s"),
    ("load transfer along", "a third of gravity along", seconds(np.abs(d.change) > GRAVITY / 3.0), "s"),
    ("biases of the sensors", "standstill with nothing commanded", standstill_seconds(recordings), "s"),
  ]
  poses = [r for r in recordings if {"pose_x", "pose_y"} <= set(r.channels)]
  rows.append(("floor, draught, places", "poses while driving", sum(r.duration for r in poses), "s"))
  return [Shown(physics, takes, float(amount), unit) for physics, takes, amount, unit in rows]


def _driven(recording: Recording, wheels: Wheels, wheelbase: float) -> tuple[Array, ...]:
  time, commands = recording.commands(_PERIOD)
  smooth = lambda v: np.convolve(np.pad(v, 2, mode="edge"), np.full(5, 0.2), "valid")
  stream = recording[wheels.channel]
  speed = smooth(wheels.scale * np.interp(time, stream.time, stream.value))
  slope = lambda v: np.gradient(v, _PERIOD) if len(v) > 1 else 0.0 * v
  if "yaw_rate" in recording:
    rate = smooth(np.interp(time, recording["yaw_rate"].time, recording["yaw_rate"].value))
  else:
    rate = speed * np.tan(commands[:, 1]) / wheelbase
  first = np.arange(len(time)) == 0
  return speed, slope(speed), commands[:, 1], np.abs(slope(smooth(commands[:, 1]))), commands[:, 0], speed * rate, first
