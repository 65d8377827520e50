"""Are a recording's numbers in the units they claim? Limits first, then kinematics: one channel witnesses another."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.recording import Recording, RecordingError, Stream, UnitError

_SPIKES = 2  # so many samples may always lie beyond a limit that allows spikes
_ALOOF = 2.0  # times what the rest of a log reaches, from which a sample is none of its motion
_BIN = 0.25  # s, over which channels are averaged before they are compared
_BINS = 10  # fewest bins that a comparison is worth
UNIT_CORRELATION = 0.6  # agreement that convicts a unit
_LOOSE, EXACT = 1.5, 1.2  # nearness to a usual unit's factor: with slip and noise between the channels, and without
_GENTLE = 4.0  # m/s^2; beyond it the wheels may spin and say nothing about acceleration
_SIGN_CORRELATION = 0.85  # agreement that convicts a sign
_USUAL_WHEELBASE = 0.256  # m, of the 1:10 car that the channels' limits are for
_TOP = 99.0  # per cent of the samples, below the speed that a car is said to reach
_SLOPE_ERROR = 0.15  # largest relative standard error of a slope that says anything


@dataclass(frozen=True)
class Suspect:
  """A unit that a channel is often logged in by mistake, and the factor to SI; `already`: it was in SI units, and has
  such a unit's factor on it."""

  channel: str
  unit: str
  scale: float
  already: bool = False


Slopes = tuple[tuple[float, Suspect], ...]


def suspects_of(channel: str) -> tuple[Suspect, ...]:
  """The units that a channel is often logged in by mistake."""
  return tuple(Suspect(channel, unit, scale) for unit, scale in CHANNELS[channel].log_units)


def check_limits(
  recording: Recording, vehicle: Mapping[str, float | str] | None = None, said: Collection[str] = ()
) -> None:
  """Raises UnitError when a channel exceeds what a car of this size can do, with the scale of the nearest usual
  unit.

  Limits are a 1:10 car's; those of motion grow with the car by Froude's similarity: speed as sqrt(length), turning as
  1 / sqrt(length). A speed that another sensor agrees with, or whose column names its unit, is what it says.

  Args:
    vehicle: [vehicle]; its wheelbase is the car's length.
    said: channels whose column names the SI unit.
  """
  vehicle = vehicle or {}
  for name, stream in recording.streams.items():
    channel, magnitude = CHANNELS[name], np.abs(stream.value)
    limit = channel.limit * _similarity(channel.unit, vehicle)
    beyond = magnitude > limit
    spikes = 0.0 if channel.is_command else channel.spikes
    if beyond.sum() <= (max(spikes * beyond.size, _SPIKES) if spikes else 0):
      continue
    if (name in said and channel.unit == "m/s") or _confirmed(recording, vehicle, name):
      continue
    suspects, typical = suspects_of(name), float(np.median(magnitude[beyond]))
    suspect = next((s for s in suspects if typical * s.scale < limit / 5.0), min(suspects, key=lambda s: s.scale))
    cure = _cure(suspect)
    if suspects and not any(typical * s.scale < limit for s in suspects):
      cure = f"no usual unit explains it: raw counts of a sensor? set scale on {name} in [channels] by its data sheet"
    if name == "motor_duty":
      cure = f"is it a speed, in m/s? map its column as speed_command in [channels]; {cure}"
    larger = "; or give the car's size in [vehicle], where it is larger" if channel.unit == "m/s" else ""
    raise UnitError(
      f"{recording.file or recording.name}: {name} reaches {magnitude.max():g} {channel.unit}, implausible "
      f"above {limit:.3g} {channel.unit} (first at {stream.time[int(np.argmax(beyond))]:g} s)",
      cure + larger,
    )


def without_spikes(
  recording: Recording, vehicle: Mapping[str, float | str] | None = None
) -> tuple[Recording, list[str]]:
  """The recording without the few samples of a sensor that `check_limits` lets pass, and a note for each channel. What
  the others lead up to is no spike, but a car faster than the limit is made for."""
  streams, notes = dict(recording.streams), []
  for name, stream in recording.streams.items():
    channel = CHANNELS[name]
    magnitude = np.abs(stream.value)
    beyond = magnitude > channel.limit * _similarity(channel.unit, vehicle or {})
    if channel.is_command or not 0 < beyond.sum() <= max(channel.spikes * beyond.size, _SPIKES):
      continue
    if magnitude[beyond].min() < _ALOOF * magnitude[~beyond].max(initial=0.0):
      continue
    streams[name] = Stream(stream.time[~beyond], stream.value[~beyond])
    samples = f"{beyond.sum()} samples" if beyond.sum() > 1 else "a sample"
    notes.append(
      f"{recording.file or recording.name}: {name} reaches {magnitude.max():.3g} {channel.unit} in"
      f" {samples} (first at {stream.time[int(np.argmax(beyond))]:g} s), which no car does: a bad reading, or a counter"
      " that wrapped; left out"
    )
  return recording.replace(streams=streams), notes


def check_way(recording: Recording, vehicle: Mapping[str, float | str]) -> None:
  """Raises RecordingError when a speed that was derived from the pose is beyond what a car of this size drives, with
  every usual unit of the pose by which it is not, and how fast it is then."""
  if "speed" not in recording.derived:
    return
  top = float(np.percentile(np.abs(recording["speed"].value), _TOP))
  limit = CHANNELS["speed"].limit * _similarity("m/s", vehicle)
  if top <= limit:
    return
  usual = [suspect for suspect in suspects_of("pose_x") if top * suspect.scale < limit]
  cures = [f"{_cure(suspect)} (it then reaches {top * suspect.scale:.2g} m/s)" for suspect in usual]
  cure = ", or ".join(cures) or "look at the scales of pose_x, pose_y and time in [channels]"
  raise RecordingError(
    f"{recording.file or recording.name}: by its pose the car reaches {top:.3g} m/s, implausible above {limit:.3g} "
    f"m/s; {cure}; or give the car's size in [vehicle], where it is larger"
  )


def _similarity(unit: str, vehicle: Mapping[str, float | str]) -> float:
  """How much further than a 1:10 car's a limit of this unit lies for a car of this wheelbase; never nearer."""
  if not {"cg_to_front", "cg_to_rear"} <= set(vehicle):
    return 1.0
  root = math.sqrt((float(vehicle["cg_to_front"]) + float(vehicle["cg_to_rear"])) / _USUAL_WHEELBASE)
  return max({"m/s": root, "rad/s": 1.0 / root}.get(unit, 1.0), 1.0)


def _confirmed(recording: Recording, vehicle: Mapping[str, float | str], name: str) -> bool:
  """Whether another sensor says the same of a channel: two that do not know of each other outweigh a limit."""
  if name == "speed_command" and "speed" in recording:
    top = [float(np.percentile(np.abs(recording[channel].value), 99.0)) for channel in (name, "speed")]
    return 0.5 * top[0] < top[1] < 2.0 * top[0] and _confirmed(recording, vehicle, "speed")
  for comparison in compare(recording, vehicle):
    slope, correlation = comparison.slope()
    if name in comparison.takes and correlation > _SIGN_CORRELATION and 1.0 / EXACT < slope < EXACT:
      return True
  return False


def _cure(suspect: Suspect) -> str:
  on = "pose_x and on pose_y" if suspect.channel == "pose_x" else suspect.channel
  return f"is it in {suspect.unit}? set scale = {suspect.scale:.6g} on {on} in [channels], times one that is there"


@dataclass(frozen=True)
class Comparison:
  """A channel's bin means (n,) and what another says they must be (n,); equal when units and signs are right."""

  channel: str
  witness: str
  measured: np.ndarray
  expected: np.ndarray
  takes: tuple[str, ...]  # the channels of both sides
  suspects: Slopes  # slope that such a unit would give
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

  def convicted(self) -> list[Suspect]:
    """The units whose factor the slope is near; of a channel's the nearest, and both where it lies between two."""
    slope, _ = self.slope()
    if not slope > 0.0:
      return []
    off = [(abs(math.log(slope / factor)), suspect) for factor, suspect in self.suspects]
    near = sorted((o for o in off if o[0] < math.log(self.tolerance)), key=lambda o: o[0])
    least = {suspect.channel: distance for distance, suspect in reversed(near)}
    return [suspect for distance, suspect in near if 0.5 * distance <= least[suspect.channel]]

  def right_by(self, unit: Suspect) -> bool:
    """Whether the two are of one size once a channel is read in this unit."""
    slope, correlation = self.slope()
    if unit.channel in self.takes:
      slope *= unit.scale if unit.channel == self.channel else 1.0 / unit.scale
    return correlation > UNIT_CORRELATION and 1.0 / _LOOSE < slope < _LOOSE


def compare(recording: Recording, vehicle: Mapping[str, float | str]) -> list[Comparison]:
  """Every comparison that the channels of this recording allow."""
  return list(_comparisons(recording, vehicle))


def check_units(recording: Recording, vehicle: Mapping[str, float | str]) -> list[str]:
  """Raises UnitError when a channel agrees with its witness but for the factor of a usual unit; returns warnings
  about signs.
  """
  notes, label = [], recording.file or recording.name
  comparisons = compare(recording, vehicle)
  for comparison in comparisons:
    slope, correlation = comparison.slope()
    units = comparison.convicted() if correlation > UNIT_CORRELATION else []
    if units:
      units = of_most(units, [other for other in comparisons if other is not comparison])
      cures = ", or ".join(dict.fromkeys(_cure(unit) for unit in units))
      raise UnitError(f"{label}: {comparison.channel} is {slope:.3g} times {comparison.witness}, implausible", cures)
    if correlation < -_SIGN_CORRELATION and -2.0 < slope < -0.5:
      notes.append(
        f"{label}: {comparison.channel} runs against {comparison.witness} (slope {slope:.2f}); signs are ISO 8855: "
        "x forward, y left, "
        "turning positive counter-clockwise, speed negative in reverse; set scale = -1 on the channel that differs"
      )
  return notes


def of_most(units: Sequence[Suspect], others: Sequence[Comparison]) -> list[Suspect]:
  """The units by which most of the other comparisons are right, of several channels that one comparison suspects."""
  right = [sum(other.right_by(unit) for other in others) for unit in units]
  return [unit for unit, count in zip(units, right, strict=True) if count == max(right)]


def _comparisons(recording: Recording, vehicle: Mapping[str, float | str]) -> Iterator[Comparison]:
  bins, channels = Bins(recording), set(recording.channels)
  speed, name = speed_in(bins, vehicle)
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


def _turning_of_pose(bins: Bins) -> Comparison:
  suspects = (*_inflated("yaw_rate"), *_deflated("pose_yaw"), *_scaled_twice("yaw_rate"))
  return Comparison(
    "yaw_rate",
    "the change of pose_yaw",
    bins.mean("yaw_rate"),
    bins.change("pose_yaw"),
    ("yaw_rate", "pose_yaw"),
    suspects,
    EXACT,
  )


def _speed_of_pose(bins: Bins, speed: np.ndarray, name: str) -> Comparison:
  suspects = (*_inflated(name), *_deflated("pose_x"))
  travelled = np.hypot(bins.change("pose_x"), bins.change("pose_y"))
  return Comparison(
    name, "the speed of pose_x, pose_y", np.abs(speed), travelled, (name, "pose_x", "pose_y"), suspects, EXACT
  )


def _turning_of_steering(bins: Bins, speed: np.ndarray, name: str, wheelbase: float) -> Comparison:
  turning = speed * np.tan(bins.mean("steering_command")) / wheelbase
  return Comparison(
    "yaw_rate",
    f"{name} x steering / wheelbase",
    bins.mean("yaw_rate"),
    turning,
    ("yaw_rate", "steering_command", name),
    _inflated("yaw_rate"),
  )


def _lateral(bins: Bins, speed: np.ndarray, name: str) -> Comparison:
  suspects = (*_inflated("accel_y"), *_deflated("yaw_rate"), *_rpm(name))
  yaw_rate = bins.mean("yaw_rate")
  return Comparison(
    "accel_y", f"{name} x yaw_rate", bins.mean("accel_y"), speed * yaw_rate, ("accel_y", name, "yaw_rate"), suspects
  )


def _longitudinal(bins: Bins, speed: np.ndarray, name: str) -> Comparison:
  suspects = (*_inflated("accel_x"), *_rpm(name))
  gained = np.gradient(speed, _BIN)
  gentle = np.where(np.abs(gained) < _GENTLE, gained, np.nan)
  return Comparison("accel_x", f"the change of {name}", bins.mean("accel_x"), gentle, ("accel_x", name), suspects)


def _inflated(channel: str) -> Slopes:
  """The slopes that a channel in another unit gives where it is the one measured."""
  return tuple((1.0 / suspect.scale, suspect) for suspect in suspects_of(channel))


def _deflated(channel: str) -> Slopes:
  """The same where it is part of what is expected."""
  return tuple((suspect.scale, suspect) for suspect in suspects_of(channel))


def _scaled_twice(channel: str) -> Slopes:
  """The slopes where a channel that is measured was in SI units already and has a usual unit's factor on it."""
  unit = f"{CHANNELS[channel].unit} already"
  return tuple((s.scale, Suspect(channel, unit, 1.0 / s.scale, already=True)) for s in suspects_of(channel))


def _rpm(name: str) -> Slopes:
  """A motor speed in rpm looks like an acceleration in g: factors 0.105 and 0.102."""
  return _deflated(name) if name == "motor_speed" else ()


def speed_in(bins: Bins, vehicle: Mapping[str, float | str]) -> tuple[np.ndarray, str]:
  """Speed in each bin, m/s (n,), and its channel; NaN when the motor's is known but no gear ratio and wheel radius."""
  if "speed" in bins.recording:
    return bins.mean("speed"), "speed"
  return bins.mean("motor_speed") * travel_of(vehicle), "motor_speed"


def travel_of(vehicle: Mapping[str, float | str]) -> float:
  """m that a car goes for a radian of its motor; NaN without gear ratio and wheel radius."""
  return float(vehicle.get("gear_ratio", math.nan)) * float(vehicle.get("wheel_radius", math.nan))


class Bins:
  """A recording in bins of 0.25 s: means of a channel, and changes per second between bin edges."""

  def __init__(self, recording: Recording) -> None:
    self.recording = recording
    self.edges = recording.start + _BIN * np.arange(max(int(recording.duration / _BIN), 2) + 1)
    self.middles = 0.5 * (self.edges[1:] + self.edges[:-1])

  def mean(self, channel: str) -> np.ndarray:
    """NaN where there is no sample."""
    bins = self.edges.size - 1
    if channel not in self.recording:
      return np.full(bins, np.nan)
    stream = self.recording[channel]
    if CHANNELS[channel].is_command:
      return stream.at(self.middles)
    index = np.clip(((stream.time - self.edges[0]) / _BIN).astype(int), 0, bins - 1)
    count = np.bincount(index, minlength=bins)
    with np.errstate(invalid="ignore", divide="ignore"):
      return np.bincount(index, stream.value, minlength=bins) / count

  def change(self, channel: str) -> np.ndarray:
    """Per second."""
    return np.diff(self.recording[channel].interpolate(self.edges)) / _BIN
