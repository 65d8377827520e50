"""Are a recording's numbers in the units they claim? Limits first, then kinematics: one channel witnesses another."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from qcar_twin.recording import Recording, RecordingError

DEGREE, GRAVITY = math.pi / 180.0, 9.80665
_SPIKES = 2  # so many samples may always lie beyond a limit that allows spikes
_BIN = 0.25  # s, over which channels are averaged before they are compared
_BINS = 10  # fewest bins that a comparison is worth
_UNIT_CORRELATION = 0.6  # agreement that convicts a unit
_LOOSE, _EXACT = 1.5, 1.2  # nearness to a usual unit's factor: with slip and noise between the channels, and without
_GENTLE = 4.0  # m/s^2; beyond it the wheels may spin and say nothing about acceleration
_SIGN_CORRELATION = 0.85  # agreement that convicts a sign
_SLOPE_ERROR = 0.15  # largest relative standard error of a slope that says anything


@dataclass(frozen=True)
class Unit:
  """A unit that a channel is often logged in by mistake, and the factor to SI."""

  channel: str
  name: str
  scale: float


@dataclass(frozen=True)
class Limit:
  """The largest magnitude that a 1:10 car can show; `fraction` of the samples may lie beyond it (spikes)."""

  value: float
  unit: str
  suspects: tuple[Unit, ...]
  fraction: float = 0.005


def _units(channel: str, **scales: float) -> tuple[Unit, ...]:
  return tuple(Unit(channel, name.replace("_per_", "/"), scale) for name, scale in scales.items())


_SPEED = _units("speed", km_per_h=1 / 3.6, cm_per_s=0.01, mm_per_s=0.001)
_MOTOR = _units("motor_speed", rpm=math.tau / 60.0)
_ACCEL_X = _units("accel_x", g=GRAVITY, mg=GRAVITY / 1000.0)
_ACCEL_Y = _units("accel_y", g=GRAVITY, mg=GRAVITY / 1000.0)
_YAW_RATE = _units("yaw_rate", deg_per_s=DEGREE)
_STEERING = _units("steering_command", degrees=DEGREE)
_YAW = _units("pose_yaw", degrees=DEGREE)
_POSE = _units("pose_x", mm=0.001, cm=0.01)

LIMITS = {
  "steering_command": Limit(1.6, "rad", _STEERING, 0.0),
  "motor_voltage": Limit(100.0, "V", _units("motor_voltage", mV=0.001), 0.0),
  "yaw_rate": Limit(15.0, "rad/s", _YAW_RATE),
  "accel_x": Limit(160.0, "m/s^2", _ACCEL_X[1:]),
  "accel_y": Limit(160.0, "m/s^2", _ACCEL_Y[1:]),
  "speed": Limit(30.0, "m/s", _SPEED[1:]),
  "motor_speed": Limit(12000.0, "rad/s", _MOTOR),
  "battery_voltage": Limit(100.0, "V", _units("battery_voltage", mV=0.001), 0.0),
  "motor_current": Limit(400.0, "A", _units("motor_current", mA=0.001)),
}


def check_limits(recording: Recording) -> None:
  """Raises RecordingError when a channel exceeds what a 1:10 car can do, with the scale of the nearest usual unit."""
  for channel, limit in LIMITS.items():
    if channel not in recording:
      continue
    magnitude = np.abs(recording[channel].value)
    beyond = magnitude > limit.value
    if beyond.sum() > (max(limit.fraction * beyond.size, _SPIKES) if limit.fraction else 0):
      at = recording[channel].time[int(np.argmax(beyond))]
      unit = next(
        (suspect for suspect in limit.suspects if np.median(magnitude[beyond]) * suspect.scale < limit.value / 5.0),
        limit.suspects[-1],
      )
      raise RecordingError(
        f"{recording.file or recording.name}: {channel} reaches {magnitude.max():g} {limit.unit}, implausible "
        f"above {limit.value:g} {limit.unit} "
        f"(first at {at:g} s); {_cure(unit)}"
      )


def _cure(unit: Unit) -> str:
  also = " (and on pose_y)" if unit.channel == "pose_x" else ""
  return f"is it in {unit.name}? set scale = {unit.scale:.6g} on {unit.channel}{also} in [channels]"


@dataclass(frozen=True)
class Comparison:
  """A channel's bin means (n,) beside what another says they must be (n,); equal when units and signs are right."""

  channel: str
  witness: str
  measured: np.ndarray
  expected: np.ndarray
  suspects: tuple[tuple[float, Unit], ...]  # slope that such a unit would give
  tolerance: float = _LOOSE

  def slope(self) -> tuple[float, float]:
    """Slope of measured on expected (with an intercept, for bias) and their correlation; NaN when there is too little
    motion or the slope's standard error, slope * sqrt((1 / correlation^2 - 1) / (n - 2)), is too large."""
    both = np.isfinite(self.measured) & np.isfinite(self.expected)
    x, y = self.expected[both], self.measured[both]
    if x.size < _BINS or x.std() == 0.0 or y.std() == 0.0:
      return math.nan, math.nan
    correlation = float(np.corrcoef(x, y)[0, 1])
    if not correlation**2 > 1.0 / (1.0 + _SLOPE_ERROR**2 * (x.size - 2)):
      return math.nan, math.nan
    return correlation * float(y.std() / x.std()), correlation

  def convicted(self) -> list[Unit]:
    """The units whose factor the slope is near."""
    slope, _ = self.slope()
    return [
      unit for factor, unit in self.suspects if slope > 0.0 and abs(math.log(slope / factor)) < math.log(self.tolerance)
    ]


def compare(recording: Recording, vehicle: Mapping[str, float | str]) -> list[Comparison]:
  """Every comparison that the channels of this recording allow."""
  return list(_comparisons(recording, vehicle))


def check_units(recording: Recording, vehicle: Mapping[str, float | str]) -> list[str]:
  """Raises RecordingError when a channel agrees with its witness but for the factor of a usual unit; returns warnings
  about signs.
  """
  notes, shown = [], recording.file or recording.name
  for comparison in compare(recording, vehicle):
    slope, correlation = comparison.slope()
    units = comparison.convicted() if correlation > _UNIT_CORRELATION else []
    if units:
      cures = ", or ".join(dict.fromkeys(_cure(unit) for unit in units))
      raise RecordingError(
        f"{shown}: {comparison.channel} is {slope:.3g} times {comparison.witness}, implausible; {cures}"
      )
    if correlation < -_SIGN_CORRELATION and -2.0 < slope < -0.5:
      notes.append(
        f"{shown}: {comparison.channel} runs against {comparison.witness} (slope {slope:.2f}); signs are ISO 8855: "
        "x forward, y left, "
        "turning positive counter-clockwise, speed negative in reverse; set scale = -1 on the channel that differs"
      )
  return notes


def _comparisons(recording: Recording, vehicle: Mapping[str, float | str]) -> Iterator[Comparison]:
  bins, channels = _Bins(recording), set(recording.channels)
  speed, name = _speed(bins, vehicle)
  if {"yaw_rate", "pose_yaw"} <= channels:
    yield _turning_of_pose(bins)
  if {"pose_x", "pose_y"} <= channels:
    yield _speed_of_pose(bins, speed, name)
  if {"yaw_rate", "steering_command"} <= channels and {"cg_to_front", "cg_to_rear"} <= set(vehicle):
    yield _turning_of_steering(bins, speed, name, float(vehicle["cg_to_front"]) + float(vehicle["cg_to_rear"]))
  if {"accel_y", "yaw_rate"} <= channels:
    yield _lateral(bins, speed, name)
  if "accel_x" in channels:
    yield _longitudinal(bins, speed, name)


def _turning_of_pose(bins: _Bins) -> Comparison:
  suspects = ((1 / DEGREE, _YAW_RATE[0]), (DEGREE, _YAW[0]))
  return Comparison(
    "yaw_rate", "the change of pose_yaw", bins.mean("yaw_rate"), bins.change("pose_yaw"), suspects, _EXACT
  )


def _speed_of_pose(bins: _Bins, speed: np.ndarray, name: str) -> Comparison:
  units = _SPEED if name == "speed" else _MOTOR
  suspects = [(1 / unit.scale, unit) for unit in units] + [(unit.scale, unit) for unit in _POSE]
  travelled = np.hypot(bins.change("pose_x"), bins.change("pose_y"))
  return Comparison(name, "the speed of pose_x, pose_y", np.abs(speed), travelled, tuple(suspects), _EXACT)


def _turning_of_steering(bins: _Bins, speed: np.ndarray, name: str, wheelbase: float) -> Comparison:
  turning = speed * np.tan(bins.mean("steering_command")) / wheelbase
  return Comparison(
    "yaw_rate", f"{name} x steering / wheelbase", bins.mean("yaw_rate"), turning, ((1 / DEGREE, _YAW_RATE[0]),)
  )


def _lateral(bins: _Bins, speed: np.ndarray, name: str) -> Comparison:
  suspects = [(1 / unit.scale, unit) for unit in _ACCEL_Y] + [(DEGREE, _YAW_RATE[0])] + _rpm(name)
  yaw_rate = bins.mean("yaw_rate")
  return Comparison("accel_y", f"{name} x yaw_rate", bins.mean("accel_y"), speed * yaw_rate, tuple(suspects))


def _longitudinal(bins: _Bins, speed: np.ndarray, name: str) -> Comparison:
  suspects = [(1 / unit.scale, unit) for unit in _ACCEL_X] + _rpm(name)
  gained = np.gradient(speed, _BIN)
  gentle = np.where(np.abs(gained) < _GENTLE, gained, np.nan)
  return Comparison("accel_x", f"the change of {name}", bins.mean("accel_x"), gentle, tuple(suspects))


def _rpm(name: str) -> list[tuple[float, Unit]]:
  """A motor speed in rpm looks like an acceleration in g: factors 0.105 and 0.102."""
  return [(unit.scale, unit) for unit in _MOTOR] if name == "motor_speed" else []


def _speed(bins: _Bins, vehicle: Mapping[str, float | str]) -> tuple[np.ndarray, str]:
  """Speed in each bin, m/s (n,), and its channel; NaN when the motor's is known but no gear ratio and wheel radius."""
  if "speed" in bins.recording:
    return bins.mean("speed"), "speed"
  metres_per_rad = float(vehicle.get("gear_ratio", math.nan)) * float(vehicle.get("wheel_radius", math.nan))
  return bins.mean("motor_speed") * metres_per_rad, "motor_speed"


class _Bins:
  """A recording in bins of 0.25 s: means of a channel, and changes per second between bin edges."""

  def __init__(self, recording: Recording) -> None:
    self.recording = recording
    self.edges = recording.start + _BIN * np.arange(max(int(recording.duration / _BIN), 2) + 1)

  def mean(self, channel: str) -> np.ndarray:
    bins = self.edges.size - 1
    if channel not in self.recording:
      return np.full(bins, np.nan)
    stream = self.recording[channel]
    if channel in ("motor_voltage", "steering_command"):
      return stream.at(0.5 * (self.edges[1:] + self.edges[:-1]))
    index = np.clip(((stream.time - self.edges[0]) / _BIN).astype(int), 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    with np.errstate(invalid="ignore", divide="ignore"):
      return np.bincount(index, stream.value, minlength=bins) / count

  def change(self, channel: str) -> np.ndarray:
    return np.diff(self.recording[channel].interpolate(self.edges)) / _BIN
