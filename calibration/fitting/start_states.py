"""Start states of stretches: what the sensors say of them, and their elimination from every least squares.

A channel's value at a time is that of a parabola through as many samples around it as agree with each other: the
widest of nested windows whose interval still meets those of all narrower ones (the intersection of confidence
intervals: Goldenshluger and Nemirovski, On spatially adaptive estimation of nonparametric regression, Mathematical
Methods of Statistics 6, 1997). Where a recording begins in a launch that is its first sample or two; in steady driving
it is all samples within 0.06 s.

A stretch of driving begins in a state x that nobody knows exactly: it was measured with a covariance P. To first order
a stretch's whitened residual is r + U z with the state's error in standard deviations z ~ N(0, I) and the slopes
U = J P^1/2. The least squares over z,

  min_z |r + U z|^2 + |z|^2 = r' (I + U U')^-1 r = |A r|^2,   A = I - Q diag(1 - 1 / sqrt(1 + s^2)) Q',

with the singular vectors Q and values s of U (the Schur complement of the normal equations in z: Golub and Pereyra, The
differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate, SIAM Journal on
Numerical Analysis 10, 1973). A is applied to residuals and slopes alike: what follows is a least squares like any
other, and its sum of squares still counts nats.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.noise_floor import driving_noise
from qcar_twin.kinematics import road_speed
from qcar_twin.plant import START
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.parameters import base_parameters
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_HALF = 0.06  # s on either side of a time, from which its value is taken
_ORDER = 2  # of the polynomial: in a launch a straight line's curvature costs more than the third coefficient does
_AGREE = 1.5  # standard deviations on either side of a value: intervals of 87 %
_SERVO = 0.15  # s within which a command before or after may still be on its way to the wheels
_AGE = 0.005  # s: a sensor's age that no log states
_LINKAGE = 0.01  # rad: play and trim of a linkage
ELIMINATED = [START.index(name) for name in ("velocity_x", "velocity_y", "yaw_rate", "steering_angle")]
_POSE = ("pose_x", "pose_y", "pose_yaw")


@dataclasses.dataclass(frozen=True)
class StartState:
  """State in the order of START, (7,), and its standard deviations, (7,); a pose is where a world begins: 0."""

  value: Array
  std: Array


def start_state(
  recording: Recording, time: float, vehicle: Vehicle, steering: float, noise: Mapping[str, float]
) -> StartState:
  """State at a time from the samples around it.

  Args:
    recording: what was measured.
    time: s, recording time.
    vehicle: numbers of the car.
    steering: command that stands then, rad.
    noise: white noise of each channel while the car rolls, see `driving_noise`.

  Sideslip is that of steady cornering: v_y = r l_r - v_x a_r with the rear axle's slip angle
  a_r = m v_x r l_f / (L C_r) of the nominal tyre, whose stiffness is known to a factor of two.
  """
  states = dict.fromkeys(START, (0.0, 0.0))
  for name in _POSE:
    if name in recording:
      states[name] = level(recording[name], time, noise.get(name, 0.0), 0.02)[0], 0.0
  states["yaw_rate"] = _yaw_rate(recording, time, noise)
  states["velocity_x"] = _speed(recording, time, vehicle, noise)
  states["velocity_y"] = _sideslip(vehicle, states["velocity_x"][0], *states["yaw_rate"])
  locked = float(np.clip(steering, -vehicle.max_steering, vehicle.max_steering))
  states["steering_angle"] = locked, _steering_std(recording, time, vehicle, steering)
  return StartState(*np.array([states[name] for name in START]).T)


def noise_while_driven(recording: Recording) -> dict[str, float]:
  """White noise of each channel of a recording while the car rolls, in its unit."""
  return driving_noise([recording])


def level(stream: Stream, time: float, noise: float, half: float = _HALF) -> tuple[float, float]:
  """Value of a channel at a time and its standard deviation; see the module. `noise`: of one sample."""
  value, std = _nearest(stream, time, noise)
  low, high = value - _AGREE * std, value + _AGREE * std
  near = np.flatnonzero(np.abs(stream.time - time) <= half)
  near = near[np.argsort(np.abs(stream.time[near] - time), kind="stable")]
  for count in range(_ORDER + 3, len(near) + 1):
    curve, spread = _curve(stream.time[near[:count]] - time, stream.value[near[:count]], noise)
    if spread > std:
      continue
    low, high = max(low, curve - _AGREE * spread), min(high, curve + _AGREE * spread)
    if low > high:
      break
    value, std = curve, spread
  return value, std


def _nearest(stream: Stream, time: float, noise: float) -> tuple[float, float]:
  """Value between the two samples around a time; the nearest where they lie on one side. It may err by how much the
  channel changes on the way to the nearest one."""
  value = float(np.interp(time, stream.time, stream.value))
  at = int(np.argmin(np.abs(stream.time - time)))
  beside = [k for k in (at - 1, at + 1) if 0 <= k < len(stream.time)]
  slopes = [abs((stream.value[k] - stream.value[at]) / (stream.time[k] - stream.time[at])) for k in beside]
  return value, float(np.hypot(noise, max(slopes, default=0.0) * abs(stream.time[at] - time)))


def _curve(time: Array, value: Array, noise: float) -> tuple[float, float]:
  """A parabola's value at 0 and its standard deviation."""
  powers = np.vander(time / np.abs(time).max(), _ORDER + 1, increasing=True)
  weights = np.linalg.pinv(powers)[0]
  return float(weights @ value), noise * float(np.sqrt(weights @ weights))


def _speed(recording: Recording, time: float, vehicle: Vehicle, noise: Mapping[str, float]) -> tuple[float, float]:
  """Speed of the wheels on the road, m/s, and its standard deviation, with the slip at the nominal tyre's stiffness."""
  if "motor_speed" in recording:
    value, std = level(recording["motor_speed"], time, noise.get("motor_speed", 0.0))
    value, std = float(road_speed(value, vehicle)), float(abs(road_speed(std, vehicle)))
  elif "speed" in recording:
    value, std = level(recording["speed"], time, noise.get("speed", 0.0))
  else:
    return 0.0, 0.0
  acceleration = _rate(recording["motor_speed" if "motor_speed" in recording else "speed"], time)
  acceleration = float(road_speed(acceleration, vehicle)) if "motor_speed" in recording else acceleration
  slip = value * vehicle.mass * acceleration / vehicle.longitudinal_stiffness
  return value, float(np.sqrt(std**2 + slip**2 + (_AGE * acceleration) ** 2))


def _yaw_rate(recording: Recording, time: float, noise: Mapping[str, float]) -> tuple[float, float]:
  if "yaw_rate" not in recording:
    return 0.0, 0.0
  stream = recording["yaw_rate"]
  value, std = level(stream, time, noise.get("yaw_rate", 0.0))
  return value, float(np.hypot(std, _AGE * _rate(stream, time)))


def _rate(stream: Stream, time: float) -> float:
  """How fast a channel changes about a time, per s."""
  span = min(time + _HALF, stream.time[-1]) - max(time - _HALF, stream.time[0])
  change = float(np.diff(np.interp([time - _HALF, time + _HALF], stream.time, stream.value))[0])
  return change / span if span > 0.0 else 0.0


def _sideslip(vehicle: Vehicle, speed: float, yaw_rate: float, yaw_std: float) -> tuple[float, float]:
  stiffness = base_parameters(vehicle)["cornering_stiffness_rear"].nominal
  wheelbase = vehicle.cg_to_front + vehicle.cg_to_rear
  slip = vehicle.mass * speed * yaw_rate * vehicle.cg_to_front / (wheelbase * stiffness)
  return yaw_rate * vehicle.cg_to_rear - abs(speed) * slip, float(np.hypot(yaw_std * vehicle.cg_to_rear, speed * slip))


def _steering_std(recording: Recording, time: float, vehicle: Vehicle, steering: float) -> float:
  """Of the road wheels' angle about the command, rad: play, and what may still be on its way through a servo."""
  if "steering_command" not in recording:
    return _LINKAGE
  around = recording["steering_command"].at(time + np.linspace(-_SERVO, _SERVO, 7), 0.0)
  return float(np.hypot(_LINKAGE, np.max(np.abs(np.nan_to_num(around, nan=steering) - steering))))


@dataclasses.dataclass(frozen=True)
class Elimination:
  """A of every stretch, for values in the order of observations.

  Attributes:
    slopes: d value / d start state in the state's standard deviations, in the channels' units, (M, k).
    basis: Q in the rows of each stretch, (M, k).
    shrink: 1 - 1 / sqrt(1 + s^2) of each stretch, (S, k).
    edges: row at which each stretch's values begin, and the end, (S + 1,).
  """

  slopes: Array
  basis: Array
  shrink: Array
  edges: NDArray[np.int64]

  @classmethod
  def of(cls, slopes: Array, scale: Array, stretch: NDArray[np.int64]) -> "Elimination":
    """From slopes (M, k), what whitens each value (M,) and the stretch of each value (M,), in rising order."""
    edges = np.append(np.flatnonzero(np.diff(stretch, prepend=-1)), len(stretch))
    basis, shrink = np.zeros_like(slopes), np.zeros((len(edges) - 1, slopes.shape[1]))
    for k, (low, high) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
      q, s, _ = np.linalg.svd(slopes[low:high] * scale[low:high, None], full_matrices=False)
      basis[low:high, : len(s)], shrink[k, : len(s)] = q, 1.0 - 1.0 / np.sqrt(1.0 + s**2)
    return cls(slopes, basis, shrink, edges)

  def apply(self, residual: Array, first: int = 0) -> None:
    """A r in place: residuals (n, m), whose values begin in row `first`, at the beginning of a stretch."""
    begin, end = np.searchsorted(self.edges, [first, first + residual.shape[1]])
    for k in range(begin, end):
      rows = slice(self.edges[k], self.edges[k + 1])
      basis, part = self.basis[rows], residual[:, self.edges[k] - first : self.edges[k + 1] - first]
      part -= ((part @ basis) * self.shrink[k]) @ basis.T
