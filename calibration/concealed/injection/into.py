"""What acts on sensors and commands, put into recordings that were driven without it, exactly.

A sensor's delay, scale, bias or clock changes nothing of the drive, so a log with it is the log, changed. A command
that acts later, or by another gain or trim, is the same drive under another command: what was logged is what would
have had to be commanded. Nothing that changes the car can be put into a log.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calibration.log_check.ready import clock
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream

IMU, WHEELS, POSE = ("accel_x", "accel_y", "yaw_rate"), ("motor_speed", "speed"), ("pose_x", "pose_y", "pose_yaw")
_THIRDS = {"right_3": -1.0, "right_2": -2 / 3, "right_1": -1 / 3, "left_1": 1 / 3, "left_2": 2 / 3, "left_3": 1.0}


@dataclass(frozen=True)
class Injection:
  """One kind.

  Attributes:
    act: act(recording, size) returns the changed recording.
    needs: any of these channels must be there.
    shows: numbers of a characterised twin that it moves, and by how much per size.
    most: largest size.  unit: of the size.  signed: whether it may be negative.
    also: numbers that name it as well, whose size is another.
  """

  act: Callable[[Recording, float], Recording]
  needs: tuple[str, ...]
  shows: Mapping[str, float]
  most: float
  unit: str
  signed: bool = False
  also: tuple[str, ...] = ()

  @property
  def right(self) -> set[str]:
    """Names that count as right."""
    return {*self.shows, *self.also}


def injected(dataset: DataSet, injection: Injection, size: float) -> DataSet:
  """The data set with it in every recording."""
  made = tuple(injection.act(recording, size) for recording in dataset.recordings)
  return DataSet(f"{dataset.name}_injected", made, dataset.vehicle, dataset.vehicle_std, "", dataset.command_timing)


def fitting(dataset: DataSet) -> dict[str, Injection]:
  """Those that the recordings have a channel for."""
  present = {name for recording in dataset.recordings for name in recording.channels}
  zero = clock(dataset.recordings)
  return {name: _against(one, zero) for name, one in INJECTIONS.items() if present & set(one.needs)}


def _against(injection: Injection, zero: str) -> Injection:
  """The same where ages are counted from the sensor that it makes older: all others get younger, commands act later."""
  if (moved := injection.shows.get(zero)) is None:
    return injection
  others = {name: -moved for name in _AGES if name != zero} | dict.fromkeys(_DELAYS, moved)
  return dataclasses.replace(injection, shows=others, also=(*injection.also, zero))


def _streams(recording: Recording, names: tuple[str, ...], change: Callable[[Stream], Stream]) -> Recording:
  there = {name: change(stream) if name in names else stream for name, stream in recording.streams.items()}
  return recording.replace(streams=there)


def _values(*names: str):
  """An `act` that changes values: change(values, size)."""

  def of(change: Callable[[np.ndarray, float], np.ndarray]) -> Callable[[Recording, float], Recording]:
    return lambda recording, size: _streams(recording, names, lambda s: Stream(s.time, change(s.value, size)))

  return of


def _late(*names: str) -> Callable[[Recording, float], Recording]:
  """Samples get a later stamp [s]."""
  return lambda recording, size: _streams(recording, names, lambda s: Stream(s.time + size, s.value))


def _early(command: str) -> Callable[[Recording, float], Recording]:
  """A command was logged earlier [s], so that the car answers later; `drive`: whichever drives the car."""

  def act(recording: Recording, size: float) -> Recording:
    name = recording.drive_channel if command == "drive" else command
    return _streams(recording, (name,), lambda s: Stream(s.time - size, s.value))

  return act


def _held(recording: Recording, size: float) -> Recording:
  """The IMU is read only every so often [s], and repeats itself in between."""

  def change(stream: Stream) -> Stream:
    tick = np.floor((stream.time - stream.time[0]) / size + 1e-9)
    first = np.r_[True, np.diff(tick) > 0.0]
    return Stream(stream.time, stream.value[first][np.cumsum(first) - 1])

  return _streams(recording, IMU, change)


def _drifting(recording: Recording, size: float) -> Recording:
  """The sensors' clock runs fast by this share, from where the recording begins."""
  sensors = tuple(name for name in recording.channels if CHANNELS[name].is_measured)
  began = recording.start
  return _streams(recording, sensors, lambda s: Stream(began + (s.time - began) * (1.0 + size), s.value))


_scaled = lambda values, size: (1.0 + size) * values
_shifted = lambda values, size: values + size
_AGES, _DELAYS = ("encoder_latency", "imu_latency", "pose_latency"), ("drive_delay", "steering_delay")

INJECTIONS: dict[str, Injection] = {
  "steering_dead_time": Injection(
    _early("steering_command"), ("steering_command",), {"steering_delay": 1.0}, 0.3, "s", also=("steering_lag",)
  ),
  "drive_dead_time": Injection(
    _early("drive"), ("motor_voltage", "motor_duty", "motor_current", "speed_command"), {"drive_delay": 1.0}, 0.3, "s",
    also=("drive_lag",),
  ),
  "steering_gain": Injection(
    _values("steering_command")(lambda values, size: values / (1.0 + size)), ("steering_command",),
    {f"steering_curve_{place}": slope for place, slope in _THIRDS.items()}, 0.4, "-", signed=True,
    also=("steering_gain_error",),
  ),
  "steering_trim": Injection(
    _values("steering_command")(lambda values, size: values - size), ("steering_command",), {"steering_offset": 1.0},
    0.1, "rad", signed=True,
  ),
  "gyro_gain": Injection(_values("yaw_rate")(_scaled), ("yaw_rate",), {"gyro_scale": 1.0}, 0.4, "-", signed=True),
  "gyro_offset": Injection(_values("yaw_rate")(_shifted), ("yaw_rate",), {"gyro_bias": 1.0}, 0.3, "rad/s", signed=True),
  "accel_offset": Injection(
    _values("accel_x")(_shifted), ("accel_x",), {"accel_bias_x": 1.0}, 3.0, "m/s^2", signed=True
  ),
  "wheels_read_less": Injection(
    _values(*WHEELS)(lambda values, size: values / (1.0 + size)), ("pose_x",), {"wheel_radius_error": 1.0}, 0.3, "-",
    signed=True,
  ),
  "wheels_age": Injection(_late(*WHEELS), WHEELS, {"encoder_latency": 1.0}, 0.2, "s"),
  "imu_age": Injection(_late(*IMU), IMU, {"imu_latency": 1.0}, 0.2, "s"),
  "imu_held": Injection(_held, IMU, {"imu_latency": 0.5}, 0.4, "s"),
  "clock_drift": Injection(_drifting, WHEELS, {}, 0.05, "-", signed=True, also=_AGES),
}  # fmt: skip
