"""What the car was doing at every measured value: named features for location and for leftovers.

Features come from the commands and from the recalibrated twin's own motion, not from the
measurements that are being judged, so that a sensor's error cannot explain itself; only the place
on the floor is the measured one.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.observations import CHANNELS, Observations
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.plant import Prediction

Array = NDArray[np.float64]

RATE_SPAN = 0.2  # s over which the steering rate is taken: the past, so that what follows a step is part of it
LAGS = (0.0, 0.05, 0.1, 0.2, 0.4)  # s, of the commands that a black box may use


@dataclasses.dataclass(frozen=True)
class Circumstances:
  """Features on the control grid of all segments.

  Attributes:
    features: name -> values, (S, T + 1), in `UNITS`.
    period: control period, s.
  """

  features: Mapping[str, Array]
  period: float

  @property
  def names(self) -> tuple[str, ...]:
    return tuple(self.features)

  def stacked(self) -> Array:
    """All features, (S, T + 1, F)."""
    return np.stack(list(self.features.values()), axis=-1)


UNITS = {
  "speed": "m/s",
  "accel_x": "m/s^2",
  "abs(accel_y)": "m/s^2",
  "abs(yaw_rate)": "rad/s",
  "steering_command": "rad",
  "abs(steering_command)": "rad",
  "abs(steering_rate)": "rad/s",
  "abs(drive_command)": "V",
  "drive_torque": "N m",
  "time": "s",
  "pose_x": "m",
  "pose_y": "m",
}


def circumstances(observations: Observations, prediction: Prediction, strength: float, damping: float) -> Circumstances:
  """Named, readable features of the driving.

  Args:
    observations: what was measured; its segments hold the commands and the measured pose.
    prediction: the twin's signals for one parameter vector.
    strength: motor torque per unit of the drive's command as it is logged, N m, motor side.
    damping: motor damping with back-EMF, N m s/rad, motor side.
  """
  segments = observations.stretches.segments
  drive, steering = held_commands(segments.commands)
  steps = int(round(RATE_SPAN / segments.period))
  rate = (steering - lagged(steering, steps)) / RATE_SPAN
  signal = lambda name: prediction.channel(name)[0]
  features = {
    "speed": np.hypot(signal("velocity_x"), signal("velocity_y")),
    "accel_x": signal("accel_x"),
    "abs(accel_y)": np.abs(signal("accel_y")),
    "abs(yaw_rate)": np.abs(signal("yaw_rate")),
    "steering_command": steering,
    "abs(steering_command)": np.abs(steering),
    "abs(steering_rate)": np.abs(rate),
    "abs(drive_command)": np.abs(drive),
    "drive_torque": strength * drive - damping * signal("motor_speed"),
    "time": segments.offset[:, None] - _beginnings(observations)[:, None] + segments.period * np.arange(rate.shape[1]),
  }
  if segments.pose is not None and np.isfinite(segments.pose).all():
    features |= {"pose_x": segments.pose[:, :, 0], "pose_y": segments.pose[:, :, 1]}
  return Circumstances({k: np.nan_to_num(v) for k, v in features.items()}, segments.period)


def commands_and_state(observations: Observations, prediction: Prediction) -> Array:
  """Present and past commands and the twin's state as they are, (S, T + 1, F): what a black box learns from."""
  u = np.stack(held_commands(observations.stretches.segments.commands), axis=-1)
  past = [lagged(u, int(round(lag / prediction.period))) for lag in LAGS]
  names = ("velocity_x", "velocity_y", "yaw_rate", "accel_x", "accel_y", "motor_speed", "steering_angle")
  state = np.stack([prediction.channel(n)[0] for n in names], axis=-1)
  return np.nan_to_num(np.concatenate([*past, state], axis=-1))


def at_values(grid: Array, observations: Observations, channel: str) -> Array:
  """Grid features (S, T + 1, F) at the measured values of a channel; the mean over the horizon for displacements."""
  flat = grid.reshape(-1, grid.shape[-1])
  point = observations.grid_points[observations.channel == CHANNELS.index(channel)]
  if RESIDUALS[channel].is_direct:
    return flat[point]
  steps = int(round(observations.horizon / observations.stretches.segments.period))
  total = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(flat, axis=0)])
  first = np.maximum(point - steps, (point // grid.shape[1]) * grid.shape[1])
  return (total[point + 1] - total[first]) / (point + 1 - first)[:, None]


def held_commands(commands: Array) -> tuple[Array, Array]:
  """Commands of drive and steering on the grid, (S, T + 1): what acts from each grid point on; the last one is held."""
  whole = np.concatenate([commands, commands[:, -1:]], axis=1)
  return whole[..., 0], whole[..., 1]


def lagged(values: Array, steps: int) -> Array:
  """Values (S, T, ...) moved later by whole steps; the first one is held."""
  return values[:, np.maximum(np.arange(values.shape[1]) - steps, 0)]


def _beginnings(observations: Observations) -> Array:
  """Time at which the recording of each segment starts, s, (S,)."""
  segments = observations.stretches.segments
  first: dict[str, float] = {}
  for name, offset in zip(segments.recording, segments.offset, strict=True):
    first[name] = min(first.get(name, np.inf), float(offset))
  return np.array([first[name] for name in segments.recording])
