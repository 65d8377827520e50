"""What recordings and predictions are compared in: one record per residual channel, in the order of their indices.

A recorded channel that is compared as it is (`yaw_rate`) and a quantity made of several (`pose_forward`) are both a
record: what it needs, and how a prediction says it. One of your own is one more: `register(ResidualChannel(...))`.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.channels import CHANNELS as RECORDED
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
Signals = Callable[[str], Array]
Model = Callable[[Signals, Vehicle], Array]
Poses = Callable[[Array, Array], Array]
Places = Callable[[Array, Array, Array], Array]
POSE = ("pose_x", "pose_y", "pose_yaw")
_POINT = 1e-6  # m, a way that has no direction


@dataclasses.dataclass(frozen=True)
class ResidualChannel:
  """A quantity in which recordings and predictions are compared.

  Attributes:
    name: of the recorded channel, or of what is made of several.
    unit: SI.
    words: what it is called in a report.
    needs: recorded channels without which it is not compared; the first is the one compared where there is a model.
    model: its value from the signals of `qcar_twin.plant.SIGNALS` at its sample times, each (n, m) by name, and the
      car's numbers.
    displacement: instead of a model, its value from the pose before and after a horizon, each (..., 3); the same for
      what was measured and what was predicted.
    path: instead of both, its value from the place before, halfway through and after a horizon, each (..., 2), m.
    way: instead of all of them, the way from the pose where a speed that was derived from poses has its window to the
      pose at its end, each (..., 3), m: the value is it over the time between them.
    noise: its standard deviation from those of the recorded channels it needs, in their order; by default the first's.
    instead: a recorded channel that says the same better; where there is one, this is not compared.
    may_lose_sign: a log may hold its magnitude only.
  """

  name: str
  unit: str
  words: str
  needs: tuple[str, ...]
  model: Model | None = None
  displacement: Poses | None = None
  path: Places | None = None
  way: Poses | None = None
  noise: Callable[..., float] = lambda first, *others: first
  instead: str = ""
  may_lose_sign: bool = False

  def __post_init__(self) -> None:
    if sum(how is not None for how in (self.model, self.displacement, self.path, self.way)) != 1:
      raise ValueError(
        f"residual channel '{self.name}' needs one of a model, a displacement, a path and a way, and no other"
      )
    unknown = [channel for channel in self.needs if channel not in RECORDED]
    if unknown or not self.needs:
      raise ValueError(
        f"residual channel '{self.name}' needs {unknown or 'nothing'}: name recorded channels; a new one has to be "
        "registered in qcar_twin.recordings.channels first"
      )

  @classmethod
  def recorded(cls, name: str, model: Model | None = None, words: str = "", **more: object) -> "ResidualChannel":
    """A recorded channel compared as it is; without a model, with the signal of its name."""
    same: Model = lambda signal, car: signal(name)
    return cls(name, RECORDED[name].unit, words or name.replace("_", " "), (name,), model or same, **more)  # type: ignore[arg-type]

  @property
  def is_direct(self) -> bool:
    """Whether single samples are compared, not what lies a horizon apart."""
    return self.model is not None or self.way is not None

  def is_compared(self, recording: Recording) -> bool:
    """Whether a recording has it. A speed that no sensor gave is that of the car, a sensor's is that of its wheels."""
    if not set(self.needs) <= recording.streams.keys() or self.instead in recording:
      return False
    return self.displacement is not None or (self.needs[0] in recording.derived) == (self.way is not None)

  @property
  def symbol(self) -> str:
    """The unit as it is printed: m/s²."""
    return self.unit.replace("^2", "²")

  @property
  def axis(self) -> str:
    """What a figure's axis and a table's row say: `yaw rate [rad/s]`."""
    return f"{self.words} [{self.symbol}]"


def displacement(before: Array, after: Array) -> Array:
  """Displacement seen from the first pose: forward, left [m], turn [rad]; poses (..., 3)."""
  delta = after - before
  cosine, sine = np.cos(before[..., 2]), np.sin(before[..., 2])
  forward = cosine * delta[..., 0] + sine * delta[..., 1]
  left = -sine * delta[..., 0] + cosine * delta[..., 1]
  return np.stack([forward, left, delta[..., 2]], axis=-1)


def along_path(before: Array, halfway: Array, after: Array) -> Array:
  """Way of the second half of a horizon seen along the first: forward, left, m; places (..., 2).

  It takes no heading: with a = halfway - before and b = after - halfway it is (a . b, a x b) / |a|. Where the place
  stays, the direction is that of x.
  """
  first, second = halfway - before, after - halfway
  length = np.maximum(np.linalg.norm(first, axis=-1), _POINT)
  forward = np.sum(first * second, axis=-1)
  left = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
  return np.stack([forward, left], axis=-1) / length[..., None]


def along_heading(before: Array, after: Array) -> Array:
  """Length of a short arc between two poses, (..., 3), along the heading halfway, m; below 0 backwards.

  A chord c whose ends differ by psi in heading belongs to an arc of c (psi / 2) / sin(psi / 2).
  """
  delta, turn = after - before, 0.5 * (after[..., 2] - before[..., 2])
  heading = before[..., 2] + turn
  return (np.cos(heading) * delta[..., 0] + np.sin(heading) * delta[..., 1]) / np.sinc(turn / np.pi)


def between(before: Array, after: Array) -> Array:
  """Distance between the places of two poses, (..., 3), m."""
  return np.linalg.norm((after - before)[..., :2], axis=-1)


def rolling_speed(signal: Signals, car: Vehicle) -> Array:
  """Speed of the car from that of its motor, m/s."""
  return signal("motor_speed") * (car.wheel_radius * car.gear_ratio)


def _two_poses(noise_x: float, noise_y: float, noise_yaw: float = 0.0) -> float:
  """A displacement's noise, m: of both poses, along one direction."""
  return float(np.hypot(noise_x, noise_y))


def _three_places(noise_x: float, noise_y: float) -> float:
  """Noise of a way seen along the one before it, m: of b - a, two ways of equal length that share a place."""
  return float(np.sqrt(3.0) * np.hypot(noise_x, noise_y))


RESIDUALS: dict[str, ResidualChannel] = {
  channel.name: channel
  for channel in (
    ResidualChannel.recorded("motor_speed"),
    ResidualChannel.recorded("speed", rolling_speed, instead="motor_speed", may_lose_sign=True),
    ResidualChannel("path_speed", "m/s", "speed of the place", ("speed", *POSE[:2]), way=between, instead="pose_yaw"),
    ResidualChannel("pose_speed", "m/s", "speed of the pose", ("speed",), way=along_heading, may_lose_sign=True),
    ResidualChannel.recorded("accel_x", words="longitudinal acceleration"),
    ResidualChannel.recorded("accel_y", words="lateral acceleration"),
    ResidualChannel.recorded("yaw_rate"),
    ResidualChannel(
      "pose_forward",
      "m",
      "displacement forward",
      POSE,
      noise=_two_poses,
      displacement=lambda before, after: displacement(before, after)[..., 0],
    ),
    ResidualChannel(
      "pose_left",
      "m",
      "displacement left",
      POSE,
      noise=_two_poses,
      displacement=lambda before, after: displacement(before, after)[..., 1],
    ),
    ResidualChannel(
      "pose_turn",
      "rad",
      "turn of the pose",
      ("pose_yaw",),
      noise=lambda noise_yaw: float(np.sqrt(2.0) * noise_yaw),
      displacement=lambda before, after: displacement(before, after)[..., 2],
    ),
    ResidualChannel(
      "path_forward",
      "m",
      "way along the path",
      POSE[:2],
      noise=_two_poses,
      path=lambda before, halfway, after: along_path(before, halfway, after)[..., 0],
      instead="pose_yaw",
    ),
    ResidualChannel(
      "path_left",
      "m",
      "way left of the path",
      POSE[:2],
      noise=_three_places,
      path=lambda before, halfway, after: along_path(before, halfway, after)[..., 1],
      instead="pose_yaw",
    ),
  )
}


def compared_in(recording: Recording) -> list[ResidualChannel]:
  """What a recording is compared in: one speed of the pose at most, its size where a place alone gave it."""
  there = [c for c in RESIDUALS.values() if c.is_compared(recording)]
  ways = [c for c in there if c.way is not None]
  return [c for c in there if c.way is None or c is ways[0]]


def register(channel: ResidualChannel) -> ResidualChannel:
  """Compare recordings and predictions in one more channel, and return its record.

  Raises:
    ValueError: another channel has its name.
  """
  if RESIDUALS.setdefault(channel.name, channel) != channel:
    raise ValueError(f"there is a residual channel '{channel.name}' already; give the new one another name")
  return channel


class _Names(Sequence[str]):
  """The names in RESIDUALS as they are now, by index."""

  def __getitem__(self, index: Any) -> Any:
    return tuple(RESIDUALS)[index]

  def __len__(self) -> int:
    return len(RESIDUALS)


class _Units(Mapping[str, str]):
  """The unit of each, as they are now."""

  def __getitem__(self, name: str) -> str:
    return RESIDUALS[name].unit

  def __iter__(self) -> Iterator[str]:
    return iter(RESIDUALS)

  def __len__(self) -> int:
    return len(RESIDUALS)


CHANNELS = _Names()
UNITS = _Units()
