"""Are the numbers of a recording in the units they claim? Limits first, then kinematics: one channel is witness of another."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from qcar_twin.recording import Recording, RecordingError

DEGREE, GRAVITY = math.pi / 180.0, 9.80665
_BIN = 0.25  # s, over which channels are averaged before they are compared
_BINS = 10  # fewest bins that a comparison is worth
_UNIT_CORRELATION, _UNIT_TOLERANCE = 0.6, 1.5  # agreement, and nearness to a usual unit's factor, that convict a unit
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
    if beyond.mean() > limit.fraction:
      at = recording[channel].time[int(np.argmax(beyond))]
      unit = next(
        (suspect for suspect in limit.suspects if np.median(magnitude[beyond]) * suspect.scale < limit.value),
        limit.suspects[-1],
      )
      raise RecordingError(
        f"{recording.file or recording.name}: {channel} reaches {magnitude.max():g} {limit.unit}, implausible above {limit.value:g} "
        f"(first at {at:g} s); {_cure(unit)}"
      )


def _cure(unit: Unit) -> str:
  also = " (and on pose_y)" if unit.channel == "pose_x" else ""
  return f"is it in {unit.name}? set scale = {unit.scale:.6g} on {unit.channel}{also} in [channels]"


@dataclass(frozen=True)
class Comparison:
  """A channel's bin means (n,) beside what another channel says they must be (n,); equal when units and signs are right."""

  channel: str
  witness: str
  measured: np.ndarray
  expected: np.ndarray
  suspects: tuple[tuple[float, Unit], ...]  # slope that such a unit would give

  def slope(self) -> tuple[float, float]:
    """Slope of measured on expected (with an intercept, for bias) and their correlation; NaN when there is too little motion
    or the slope's standard error, slope * sqrt((1 / correlation^2 - 1) / (n - 2)), is too large."""
    both = np.isfinite(self.measured) & np.isfinite(self.expected)
    x, y = self.expected[both], self.measured[both]
    if x.size < _BINS or x.std() == 0.0 or y.std() == 0.0:
      return math.nan, math.nan
    correlation = float(np.corrcoef(x, y)[0, 1])
    if not correlation**2 > 1.0 / (1.0 + _SLOPE_ERROR**2 * (x.size - 2)):
      return math.nan, math.nan
    return correlation * float(y.std() / x.std()), correlation


def compare(recording: Recording, vehicle: Mapping[str, float | str]) -> list[Comparison]:
  """Every comparison that the channels of this recording allow."""
  return list(_comparisons(recording, vehicle))


def check_units(recording: Recording, vehicle: Mapping[str, float | str]) -> list[str]:
  """Raises RecordingError when a channel agrees with its witness but for the factor of a usual unit; returns warnings about signs."""
  notes, shown = [], recording.file or recording.name
  for comparison in compare(recording, vehicle):
    slope, correlation = comparison.slope()
    units = (
      [unit for factor, unit in comparison.suspects if _near(slope, factor)] if correlation > _UNIT_CORRELATION else []
    )
    if units:
      cures = ", or ".join(dict.fromkeys(_cure(unit) for unit in units))
      raise RecordingError(
        f"{shown}: {comparison.channel} is {slope:.3g} times {comparison.witness}, implausible; {cures}"
      )
    if correlation < -_SIGN_CORRELATION and -2.0 < slope < -0.5:
      notes.append(
        f"{shown}: {comparison.channel} runs against {comparison.witness} (slope {slope:.2f}); signs are ISO 8855: x forward, y left, "
        "turning positive counter-clockwise, speed negative in reverse; set scale = -1 on the channel that differs"
      )
  return notes


def _near(slope: float, factor: float) -> bool:
  return slope > 0.0 and abs(math.log(slope / factor)) < math.log(_UNIT_TOLERANCE)


def _comparisons(recording: Recording, vehicle: Mapping[str, float | str]) -> Iterator[Comparison]:
  mean, change = _Bins(recording).mean, _Bins(recording).change
  speed, speed_name, speed_units = _speed(recording, vehicle)
  yaw_rate = mean("yaw_rate")
  rpm = [
    (unit.scale, unit) for unit in speed_units if unit in _MOTOR
  ]  # looks like an acceleration in g: 0.105 against 0.102
  if {"yaw_rate", "pose_yaw"} <= set(recording.channels):
    suspects = [(1 / _YAW_RATE[0].scale, _YAW_RATE[0]), (_YAW[0].scale, _YAW[0])]
    yield Comparison("yaw_rate", "the change of pose_yaw", yaw_rate, change("pose_yaw"), tuple(suspects))
  if {"pose_x", "pose_y"} <= set(recording.channels):
    suspects = [(1 / unit.scale, unit) for unit in speed_units] + [(unit.scale, unit) for unit in _POSE]
    travelled = np.hypot(change("pose_x"), change("pose_y"))
    yield Comparison(speed_name, "the speed of pose_x, pose_y", np.abs(speed), travelled, tuple(suspects))
  if (
    {"yaw_rate", "steering_command"} <= set(recording.channels) and "cg_to_front" in vehicle and "cg_to_rear" in vehicle
  ):
    wheelbase = float(vehicle["cg_to_front"]) + float(vehicle["cg_to_rear"])
    suspects = [(1 / _YAW_RATE[0].scale, _YAW_RATE[0]), (_STEERING[0].scale, _STEERING[0])]
    turning = speed * np.tan(mean("steering_command")) / wheelbase
    yield Comparison("yaw_rate", f"{speed_name} x steering / wheelbase", yaw_rate, turning, tuple(suspects))
  if {"accel_y", "yaw_rate"} <= set(recording.channels):
    suspects = [(1 / unit.scale, unit) for unit in _ACCEL_Y] + [(_YAW_RATE[0].scale, _YAW_RATE[0])]
    suspects += rpm
    yield Comparison("accel_y", f"{speed_name} x yaw_rate", mean("accel_y"), speed * yaw_rate, tuple(suspects))
  if "accel_x" in recording:
    suspects = [(1 / unit.scale, unit) for unit in _ACCEL_X] + rpm
    yield Comparison(
      "accel_x", f"the change of {speed_name}", mean("accel_x"), np.gradient(speed, _BIN), tuple(suspects)
    )


def _speed(recording: Recording, vehicle: Mapping[str, float | str]) -> tuple[np.ndarray, str, tuple[Unit, ...]]:
  """Speed in each bin, m/s (n,); NaN when only motor speed is known and the vehicle gives no gear ratio and wheel radius."""
  bins = _Bins(recording)
  if "speed" in recording:
    return bins.mean("speed"), "speed", _SPEED
  metres_per_rad = float(vehicle.get("gear_ratio", math.nan)) * float(vehicle.get("wheel_radius", math.nan))
  return bins.mean("motor_speed") * metres_per_rad, "motor_speed", _MOTOR


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
