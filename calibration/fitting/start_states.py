"""The state in which a simulation begins, read off the samples around its beginning.

A channel's value at a time is that of a parabola through as many samples around it as agree with each other: the
widest of nested windows whose interval still meets those of all narrower ones (the intersection of confidence
intervals: Goldenshluger and Nemirovski, On spatially adaptive estimation of nonparametric regression, Mathematical
Methods of Statistics 6, 1997). Where a recording begins in a launch that is its first sample or two; in steady driving
it is all samples within 0.06 s. The yaw rate of a log without a gyro is the slope of its heading, taken likewise, and
the speed of one without a sensor of it that of its way; without gyro and heading the yaw rate is the one with which a
car that does not slip turns as it is steered.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.noise_floor import driving_noise
from qcar_twin.kinematics import kinematic_yaw_rate, road_speed
from qcar_twin.plant import START
from qcar_twin.recordings.completed import ways
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_HALF = 0.06  # s on either side of a time, from which its value is taken
_PACE = 0.25  # s on either side, from which its slope is taken: poses come ten times a second in some logs
_ORDER = 2  # of the polynomial: in a launch a straight line's curvature costs more than the third coefficient does
_AGREE = 1.5  # standard deviations on either side of a value: intervals of 87 %
_AGREE_IN_SLOPE = 2.5  # 99 %: a few samples' slope is worth nothing, and must not be the last by chance
STANDS = 0.02  # m/s: a car that is slower when its recording begins waits to be driven
_TOLD = 2.0  # standard deviations: a speed nearer to zero cannot be told from none
_POSE = ("pose_x", "pose_y", "pose_yaw")


def measured_start(
  recording: Recording,
  time: float,
  vehicle: Vehicle,
  steering: float,
  at_beginning: bool,
  noise: Mapping[str, float] | None = None,
) -> Array:
  """State at a time from the samples around it, in the order of START, (7,).

  Args:
    recording: what was measured.
    time: s, recording time.
    vehicle: numbers of the car.
    steering: command that stands then, rad.
    at_beginning: the recording begins then; a car that stands in its first sample, as far as its speed tells, starts
      at rest.
    noise: white noise of each channel while the car rolls; `driving_noise` of this recording by default.

  Speed is that of the wheels, or of the car where its pose says it, and sideslip that of a rear axle that does not
  slip, v_y = r l_r; what a car's own tyres slip there is for the twin to add, see qcar_twin/twin/starts.py.
  """
  white = driving_noise([recording]) if noise is None else noise
  at = lambda name, half=_HALF: level(recording[name], time, white.get(name, 0.0), half) if name in recording else 0.0
  states = dict.fromkeys(START, 0.0) | {name: at(name, 0.02) for name in _POSE}
  states["steering_angle"] = float(np.clip(steering, -vehicle.max_steering, vehicle.max_steering))
  if "motor_speed" in recording:
    speed = float(road_speed(at("motor_speed"), vehicle))
  else:
    placed = "speed" in recording.derived and "pose_x" in recording
    speed = _of_pose(recording, time, white) if placed else at("speed")
  turn, unsure = at("yaw_rate"), white.get("yaw_rate", 0.0)
  if "yaw_rate" not in recording and "pose_yaw" in recording:
    turn, unsure = slope(recording["pose_yaw"], time, white.get("pose_yaw", 0.0))
  elif "yaw_rate" not in recording:
    turn = float(kinematic_yaw_rate(speed, states["steering_angle"], vehicle.cg_to_front, vehicle.cg_to_rear))
  if not at_beginning or abs(speed) >= max(STANDS, _TOLD * _speed_noise(white, recording, vehicle)):
    states |= {"velocity_x": speed, "yaw_rate": turn, "velocity_y": turn * vehicle.cg_to_rear}
    if at_beginning and {"yaw_rate", "pose_yaw"} & set(recording.channels):
      states["steering_angle"] = _turned(states, unsure, vehicle)
  return np.array([states[name] for name in START])


def read_off_pose(recording: Recording) -> NDArray[np.bool_]:
  """Which states of a start the pose says, in the order of START, (7,)."""
  turning = {"yaw_rate", "velocity_y"} if "yaw_rate" not in recording and "pose_yaw" in recording else set()
  said = turning | ({"velocity_x"} if "speed" in recording.derived else set())
  return np.array([name in said for name in START])


def pushed(recording: Recording, time: float, noise: Mapping[str, float]) -> float:
  """Acceleration along the car at a time by its accelerometer, m/s^2; NaN without one.

  Tyres slip as they push. Where wheels spin or are braked the encoder's rate is that of the wheels, and within 0.1 s of
  a step of the command it is that of before and after.
  """
  if "accel_x" not in recording:
    return float("nan")
  return level(recording["accel_x"], time, noise.get("accel_x", 0.0))


def _of_pose(recording: Recording, time: float, white: Mapping[str, float]) -> float:
  """Speed of the car at a time by its pose, m/s; its size where no heading says which way it goes."""
  sides = [(way, white.get(name, 0.0)) for way, name in zip(ways(recording), ("pose_x", "pose_y"), strict=False)]
  rates = [slope(way, time, noise)[0] for way, noise in sides]
  return rates[0] if len(rates) == 1 else float(np.linalg.norm(rates))


def _speed_noise(white: Mapping[str, float], recording: Recording, vehicle: Vehicle) -> float:
  """Noise of a sample of the speed that a start is read off, m/s."""
  if "motor_speed" in recording:
    return float(road_speed(white.get("motor_speed", 0.0), vehicle))
  return white.get("speed", 0.0)


def _turned(states: Mapping[str, float], noise: float, vehicle: Vehicle) -> float:
  """Angle of the road wheels, rad, with which the car turns as it does: delta = r L / v_x, kinematic.

  The command is a prior with the standard deviation of angles spread evenly over what the wheels can do: where the car
  hardly moves, its turning says nothing. Whether a first command has acted yet every fit finds for its log
  (WHEELS_AT_COMMAND in qcar_twin/twin/parameters.py).
  """
  command, limit = states["steering_angle"], vehicle.max_steering
  per_rate = (vehicle.cg_to_front + vehicle.cg_to_rear) / states["velocity_x"]
  kinematic = float(np.clip(states["yaw_rate"] * per_rate, -limit, limit))
  doubt = (noise * per_rate) ** 2 / (limit**2 / 3.0)
  return (kinematic + doubt * command) / (1.0 + doubt)


def level(stream: Stream, time: float, noise: float, half: float = _HALF) -> float:
  """Value of a channel at a time; see the module. `noise`: of one sample."""
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
  return value


def _nearest(stream: Stream, time: float, noise: float) -> tuple[float, float]:
  """Value between the two samples around a time; the nearest where they lie on one side. It may err by how much the
  channel changes on the way to the nearest one."""
  value = float(np.interp(time, stream.time, stream.value))
  at = int(np.argmin(np.abs(stream.time - time)))
  neighbours = [k for k in (at - 1, at + 1) if 0 <= k < len(stream.time)]
  slopes = [abs((stream.value[k] - stream.value[at]) / (stream.time[k] - stream.time[at])) for k in neighbours]
  return value, float(np.hypot(noise, max(slopes, default=0.0) * abs(stream.time[at] - time)))


def slope(stream: Stream, time: float, noise: float) -> tuple[float, float]:
  """How fast a channel changes at a time, per s, and its standard deviation: of the widest parabola, as `level`."""
  away = np.abs(stream.time - time)
  near = np.argsort(away, kind="stable")[: max(_ORDER + 1, int(np.sum(away <= _PACE)))]
  low, high, best = -np.inf, np.inf, (0.0, np.inf)
  for count in range(_ORDER + 1, len(near) + 1):
    rate, spread = _curve(stream.time[near[:count]] - time, stream.value[near[:count]], noise, 1)
    low, high = max(low, rate - _AGREE_IN_SLOPE * spread), min(high, rate + _AGREE_IN_SLOPE * spread)
    if low > high:
      break
    best = rate, spread
  return best


def _curve(time: Array, value: Array, noise: float, order: int = 0) -> tuple[float, float]:
  """A parabola's value, or slope for order 1, at 0 and its standard deviation."""
  scale = np.abs(time).max()
  weights = np.linalg.pinv(np.vander(time / scale, _ORDER + 1, increasing=True))[order] / scale**order
  return float(weights @ value), noise * float(np.sqrt(weights @ weights))
