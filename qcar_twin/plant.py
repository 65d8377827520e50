"""What every simulator of a car answers: the signals, the stretches of driving, the protocol.

`Twin` (MuJoCo) and `Bicycle` (the paper's identified model) are both a `Plant`: commands in,
the same ten signals out, on the same control grid, for any number of parameter vectors and
recordings at once.
"""

import dataclasses
import difflib
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import ParameterSet
from qcar_twin.recordings.channels import COMMANDS

SIGNALS = (
  "pose_x",  # m, centre of gravity, world frame
  "pose_y",  # m
  "pose_yaw",  # rad, unwrapped, counter-clockwise positive
  "velocity_x",  # m/s at the centre of gravity, body frame, forward
  "velocity_y",  # m/s, left
  "yaw_rate",  # rad/s
  "accel_x",  # m/s^2, specific force at the IMU, body frame
  "accel_y",  # m/s^2
  "motor_speed",  # rad/s, motor side
  "steering_angle",  # rad, mean road-wheel angle
)
# of the 0.2 s before a stretch (after, where a recording begins): mean drive command, in its unit, mean speed of the
# motor, rad/s, and its change, rad/s^2; when the middle of that was, s after the stretch's start
LEAD = ("command", "motor_speed", "motor_acceleration", "when")
START = ("pose_x", "pose_y", "pose_yaw", "velocity_x", "velocity_y", "yaw_rate", "steering_angle")
POSITION, POSE, VELOCITY = slice(0, 2), slice(0, 3), slice(3, 5)  # columns of SIGNALS and of START
YAW, YAW_RATE = SIGNALS.index("pose_yaw"), SIGNALS.index("yaw_rate")  # in both, too
VOLTAGE, STEERING = range(len(COMMANDS))  # columns of COMMANDS
SUBSTEPS = 5  # simulation steps per control period of 10 ms of a car of the QCar's class: 2 ms

Array = NDArray[np.float64]


def signal_index(name: str) -> int:
  """Position of a signal in SIGNALS; a clear KeyError otherwise."""
  if name not in SIGNALS:
    near = difflib.get_close_matches(name, SIGNALS, n=2) or SIGNALS
    raise KeyError(f"no signal '{name}'; did you mean {', '.join(near)}?")
  return SIGNALS.index(name)


@dataclasses.dataclass(frozen=True)
class Driving:
  """What recordings cover.

  Attributes:
    first, last: when their driving begins and ends, s driven in the data set.
    places: x, y of the car wherever its pose was measured, m, world frame, (k, 2).
  """

  first: float
  last: float
  places: Array


@dataclasses.dataclass(frozen=True)
class Segments:
  """Stretches of driving of equal padded length.

  Attributes:
    commands: drive command [V, or what the car's drive takes] and steering command [rad] held over each control period,
      (S, T, 2).
    start: initial state in the order of START, (S, 7).
    steps: number of valid control periods of each segment, (S,).
    period: control period, s.
    recording: name of the recording each segment was cut from, S of them.
    offset: time within that recording at which the segment starts, s, (S,).
    history: driving before each segment, (S, 2): seconds, and the integral of the drive command
      squared, V^2 s of a voltage (heat and charge carry over from recording to recording); None for a fresh car.
    pose: measured x, y, yaw on the control grid, (S, T + 1, 3), NaN where there is none; what a place-
      or heading-bound effect looks up; None to use the simulated pose.
    start_rate: how fast the measured states were changing there, per s, (S, 7): what a sensor that speaks late has
      missed; None where nobody knows.
    start_push: acceleration along the car there by an accelerometer, m/s^2, (S,), NaN where there is none: the force of
      its tyres over its mass, whatever its wheels do; None for the rate of the speed.
    start_by_pose: which of the states were read off the pose, (S, 7), and not off a sensor of their own: a speed is the
      car's then and not its wheels', and as late as the pose is; None where none was.
    lead: how the car was driven just before, (S, 4), in the order of LEAD, NaN where it stood: what a controller with a
      memory has in it; None where nobody knows.
    before: commands of the K periods before each segment, (S, K, 2), the newest last, NaN before a recording began:
      what is still on its way; None where nobody knows.
    wheel_angle: angle the wheels have turned since the recording's start by the encoder, mean of all, on the
      control grid, rad, (S, T + 1), NaN where unknown; what an effect that comes round with the wheels looks
      up; None to use the simulated angle, which starts at 0 in every segment.
  """

  commands: Array
  start: Array
  steps: NDArray[np.int64]
  period: float
  recording: tuple[str, ...]
  offset: Array
  history: Array | None = None
  pose: Array | None = None
  wheel_angle: Array | None = None
  start_rate: Array | None = None
  start_push: Array | None = None
  lead: Array | None = None
  before: Array | None = None
  start_by_pose: NDArray[np.bool_] | None = None

  def __post_init__(self) -> None:
    size = len(self.recording)
    if self.commands.ndim != 3 or self.commands.shape[0] != size or self.commands.shape[2] != 2:
      raise ValueError(f"commands must be ({size}, T, 2), got {self.commands.shape}")
    if self.start.shape != (size, len(START)):
      raise ValueError(f"start must be ({size}, {len(START)}), got {self.start.shape}")
    for name, values in (("command", self.commands), ("start", self.start)):
      if not np.isfinite(values).all():
        where = np.argwhere(~np.isfinite(values))[0]
        row = f" in period {where[1]}" if name == "command" else ""
        raise ValueError(f"{name} of segment {where[0]} is no finite number{row}; give finite numbers")
    if len(self.steps) != size or (np.asarray(self.steps) > self.commands.shape[1]).any():
      raise ValueError(f"steps must be {size} numbers of at most {self.commands.shape[1]}: {np.asarray(self.steps)}")

  def __len__(self) -> int:
    return len(self.recording)

  def __getitem__(self, which: slice | NDArray[np.intp]) -> "Segments":
    """Some of the stretches, padded as all are."""
    some = lambda a: None if a is None else a[which]
    names = self.recording[which] if isinstance(which, slice) else tuple(self.recording[i] for i in which)
    return Segments(
      self.commands[which], self.start[which], self.steps[which], self.period,
      names, self.offset[which],
      some(self.history), some(self.pose), some(self.wheel_angle), some(self.start_rate), some(self.start_push),
      some(self.lead), some(self.before), some(self.start_by_pose),
    )  # fmt: skip

  @property
  def by_pose(self) -> NDArray[np.bool_]:
    """Which of the start states were read off the pose, (S, 7)."""
    return np.zeros(self.start.shape, dtype=bool) if self.start_by_pose is None else self.start_by_pose

  @property
  def driving(self) -> Driving:
    """When and where all of it was driven."""
    before = np.zeros(len(self)) if self.history is None else self.history[:, 0]
    places = self.measured_pose[..., :2].reshape(-1, 2)
    last = float((before + self.period * self.steps).max())
    return Driving(float(before.min()), last, places[np.isfinite(places).all(axis=1)])

  @property
  def measured_pose(self) -> Array:
    """Measured x, y [m], yaw and wheel angle [rad] on the control grid, (S, T + 1, 4), NaN where unknown."""
    known = np.full((len(self), self.commands.shape[1] + 1, 4), np.nan)
    if self.pose is not None:
      known[..., :3] = self.pose
    if self.wheel_angle is not None:
      known[..., 3] = self.wheel_angle
    return known


@dataclasses.dataclass(frozen=True)
class Prediction:
  """Signals of n parameter vectors over S segments, (n, S, T + 1, 10); row 0 is the start."""

  signals: Array
  period: float

  def channel(self, name: str) -> Array:
    """One signal, (n, S, T + 1)."""
    return self.signals[..., signal_index(name)]


class Simulation(Protocol):
  """Cars under way, advanced one control period at a time."""

  signals: Array  # (N, 10)

  def step(self, commands: Array) -> Array:
    """Hold commands (N, 2) for one control period; return the signals after it, (N, 10)."""
    ...


class Plant(Protocol):
  """A simulator of a car."""

  period: float
  parameters: ParameterSet

  def begin(self, theta: Array, start: Array) -> Simulation:
    """N cars with parameters (N, P) at states (N, 7), at rest in every hidden state."""
    ...

  def rollout(self, theta: Array, segments: Segments) -> Prediction:
    """Every parameter vector, (n, P), over every segment."""
    ...
