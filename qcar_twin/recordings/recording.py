"""A recording: one run of one car, as asynchronous streams of SI channels (ISO 8855 signs)."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from qcar_twin.recordings import held
from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS

ROLES = ("identify", "validate", "holdout")


class RecordingError(ValueError):
  """A recording or data set that cannot be used; the text names file, channel, row and cure."""


class UnitError(RecordingError):
  """What is in another unit than it is read in, by itself or by another sensor: what is `said` of it, and the cure."""

  def __init__(self, said: str, cure: str) -> None:
    super().__init__(f"{said}; {cure}")
    self.said = said


class UnknownChannelError(RecordingError, KeyError):
  """A channel that does not exist, or that this recording does not hold."""

  __str__ = ValueError.__str__  # KeyError would print the text inside quotes


def nearest(name: str, valid: Iterable[str], cutoff: float = 0.6) -> str:
  """The ending of an error text: `; did you mean 'yaw_rate'?`, or the list of valid names when none is near."""
  names = list(valid)
  close = difflib.get_close_matches(name, names, n=1, cutoff=cutoff)
  if close:
    return f"; did you mean '{close[0]}'?"
  return f"; valid are: {', '.join(names)}" if names else ""


def _frozen(array: object) -> np.ndarray:
  copy = np.array(array, dtype=float)
  copy.flags.writeable = False
  return copy


@dataclass(frozen=True, eq=False)
class Stream:
  """Samples of one channel: `time` (k,) in s, strictly increasing, and `value` (k,) in the channel's SI unit.

  Both arrays are read-only float64. Raises RecordingError for unequal lengths, NaN, infinity or time that does not
  increase.
  """

  time: np.ndarray
  value: np.ndarray

  def __post_init__(self) -> None:
    time, value = _frozen(self.time), _frozen(self.value)
    object.__setattr__(self, "time", time)
    object.__setattr__(self, "value", value)
    if time.ndim != 1 or time.shape != value.shape:
      raise RecordingError(f"a stream needs time and value of one length, not {time.shape} and {value.shape}")
    if not (np.isfinite(time).all() and np.isfinite(value).all()):
      raise RecordingError("a stream holds only finite samples: leave out the samples that are NaN or infinite")
    if time.size > 1 and np.diff(time).min() <= 0.0:
      row = int(np.argmin(np.diff(time) > 0.0)) + 1
      raise RecordingError(f"time must increase: {time[row]:g} s follows {time[row - 1]:g} s at sample {row + 1}")

  def __len__(self) -> int:
    return self.time.size

  def at(self, time: np.ndarray, tolerance: float = 1e-9) -> np.ndarray:
    """Zero-order hold: the last value at or before each time (s); before the first sample, the first value."""
    index = np.searchsorted(self.time, np.asarray(time) + tolerance, side="right") - 1
    return self.value[np.maximum(index, 0)]

  def interpolate(self, time: np.ndarray, tolerance: float = 1e-9) -> np.ndarray:
    """Linear interpolation at each time (s); NaN outside the stream's own span."""
    time = np.asarray(time, dtype=float)
    inside = (time >= self.time[0] - tolerance) & (time <= self.time[-1] + tolerance)
    return np.where(inside, np.interp(time, self.time, self.value), np.nan)


@dataclass(frozen=True, eq=False)
class Recording:
  """One run of one car. Streams are asynchronous: each channel has its own sample times.

  `before`: seconds driven and V^2 s spent in the data set before this run, for heat, charge and wear; None where nobody
  knows, for instance outside a data set. `origin`: s, m and m that were taken off the log's own time and
  place. `derived`: channels that no sensor measured but that others of this recording gave; they testify of nothing.

  Raises UnknownChannelError for a stream that is no channel, RecordingError for an unknown role or no samples at all.
  """

  name: str
  streams: Mapping[str, Stream]
  file: str = ""
  role: str = "identify"
  manoeuvre: str = "free_driving"
  session: str | None = None
  before: tuple[float, float] | None = None
  origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
  derived: tuple[str, ...] = ()

  def __post_init__(self) -> None:
    valid = [name for name in CHANNELS if name != "time"]
    for name in self.streams:
      if name not in valid:
        raise UnknownChannelError(f"recording '{self.name}': unknown channel '{name}'{nearest(name, valid)}")
    if self.role not in ROLES:
      raise RecordingError(f"recording '{self.name}': unknown role '{self.role}'{nearest(self.role, ROLES)}")
    kept = {name: self.streams[name] for name in valid if name in self.streams and len(self.streams[name])}
    if not kept:
      raise RecordingError(f"recording '{self.name}' holds no samples")
    object.__setattr__(self, "streams", MappingProxyType(kept))

  @classmethod
  def from_columns(
    cls, name: str, time: np.ndarray, columns: Mapping[str, np.ndarray], **about: str | None
  ) -> Recording:
    """Build from columns on one clock `time` (k,) in s; NaN is no sample. `about`: file, role, manoeuvre, session."""
    streams = {}
    for channel, column in columns.items():
      value = np.asarray(column, dtype=float)
      there = ~np.isnan(value)
      if there.any():
        try:
          streams[channel] = Stream(np.asarray(time, dtype=float)[there], value[there])
        except RecordingError as error:
          raise RecordingError(f"recording '{name}', {channel}: {error}") from error
    return cls(name, streams, **about)  # type: ignore[arg-type]

  @property
  def channels(self) -> tuple[str, ...]:
    """Names of the channels that have samples, in canonical order."""
    return tuple(self.streams)

  @property
  def start(self) -> float:
    """Time of the earliest sample of any channel, s."""
    return min(float(stream.time[0]) for stream in self.streams.values())

  @property
  def end(self) -> float:
    """Time of the latest sample of any channel, s."""
    return max(float(stream.time[-1]) for stream in self.streams.values())

  @property
  def duration(self) -> float:
    """Time from the first to the last sample, s."""
    return self.end - self.start

  def __contains__(self, channel: object) -> bool:
    return channel in self.streams

  def __getitem__(self, channel: str) -> Stream:
    """The stream of a channel; UnknownChannelError names the nearest channel that this recording holds."""
    if channel in self.streams:
      return self.streams[channel]
    what = "has no channel" if channel in CHANNELS else "unknown channel"
    raise UnknownChannelError(f"recording '{self.name}': {what} '{channel}'{nearest(channel, self.channels)}")

  def replace(self, **changes: object) -> Recording:
    """A copy with some fields changed."""
    return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

  def window(self, start: float, end: float) -> Recording:
    """The samples with start <= time <= end, s. A command that is in force at `start` becomes a sample there, so that
    the zero-order hold is the same inside and outside the window, and so does the battery's voltage that it acts with.
    Raises RecordingError when nothing is left."""
    streams, held = {}, [name for name in self.streams if CHANNELS[name].is_command or name == "battery_voltage"]
    for name, stream in self.streams.items():
      inside = (stream.time >= start) & (stream.time <= end)
      time, value = stream.time[inside], stream.value[inside]
      earlier = stream.time < start
      if name in held and earlier.any() and (time.size == 0 or time[0] > start):
        time, value = np.r_[start, time], np.r_[stream.value[earlier][-1], value]
      if time.size:
        streams[name] = Stream(time, value)
    if not any(CHANNELS[name].is_measured for name in streams):
      raise RecordingError(
        f"recording '{self.name}' has no measurement between {start:g} s and {end:g} s: "
        f"it runs from {self.start:g} s to {self.end:g} s"
      )
    return dataclasses.replace(self, streams=streams)

  def grid(self, period: float, after: float = 0.0) -> np.ndarray:
    """Times start + after, a period later, ... up to the end, s (T,)."""
    if not period > 0.0:
      raise RecordingError(f"period must be positive, not {period:g} s")
    return self.start + after + period * np.arange(int(np.floor((self.duration - after) / period + 1e-6)) + 1)

  def resample(self, period: float) -> dict[str, np.ndarray]:
    """Every channel on one grid of `period` s, with the grid as "time": measurements linear (NaN outside their own
    span), commands by zero-order hold. All arrays (T,), in SI units."""
    time = self.grid(period)
    columns = {"time": time}
    for name, stream in self.streams.items():
      sample = stream.at if CHANNELS[name].is_command else stream.interpolate
      columns[name] = sample(time, 1e-6 * period)
    return columns

  @property
  def drive_channel(self) -> str:
    """The command that drives the car: the first of DRIVE_COMMANDS that was logged; a voltage where none was."""
    return next((name for name in DRIVE_COMMANDS if name in self.streams), DRIVE_COMMANDS[0])

  def commands(
    self, period: float, names: Sequence[str] = (), supply: float | None = None
  ) -> tuple[np.ndarray, np.ndarray]:
    """Time (T,) in s on the grid of `period`, and commands (T, c), each by zero-order hold, in the order of `names`:
    `drive_channel` in its unit and steering_command [rad] where none are given.

    Row k acts from time k until time k + period. A command that is absent is 0; before its first sample it has the
    value of that sample. A duty is a share of the battery's voltage: where that was logged and `supply`, V, is given,
    it becomes the share of `supply` that puts the same voltage on the motor.
    """
    time = self.grid(period)
    return time, self._commands(names, lambda stream: stream.at(time, 1e-6 * period), time, supply)

  def mean_commands(
    self, period: float, names: Sequence[str] = (), supply: float | None = None
  ) -> tuple[np.ndarray, np.ndarray]:
    """The same for a car that is to be driven with them: time (T,) on a grid that begins where they change, less than a
    period after the recording does, and the mean of each held command over each period (qcar_twin/recordings/held.py).
    """
    told = [self.streams[name] for name in self._commanded(names) if name in self.streams]
    time = self.grid(period, held.phase(told, self.start, period))
    return time, self._commands(names, lambda stream: held.means(stream, time, period), time, supply)

  def _commanded(self, names: Sequence[str]) -> Sequence[str]:
    return names or (self.drive_channel, "steering_command")

  def _commands(
    self, names: Sequence[str], sampled: Callable[[Stream], np.ndarray], time: np.ndarray, supply: float | None
  ) -> np.ndarray:
    """Commands (T, c) of names, a duty as the share of `supply` that the battery gave at each time (T,)."""
    names = self._commanded(names)
    commands = np.zeros((time.size, len(names)))
    for column, name in enumerate(names):
      if name in self.streams:
        commands[:, column] = sampled(self.streams[name])
      if name == "motor_duty" and supply is not None and (battery := self.battery) is not None:
        commands[:, column] *= np.interp(time, battery.time, battery.value) / supply
    return commands

  @property
  def battery(self) -> Stream | None:
    """The battery's voltage [V] where it was logged, without readings of zero, which are none; else None."""
    stream = self.streams.get("battery_voltage")
    if stream is None or not (stream.value > 0.0).any():
      return None
    return Stream(stream.time[stream.value > 0.0], stream.value[stream.value > 0.0])

  def columns(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The streams as one table: every sample time once (k,), s, and each channel (k,), NaN where it has no sample."""
    time = np.unique(np.concatenate([stream.time for stream in self.streams.values()]))
    table = {name: np.full(time.size, np.nan) for name in self.streams}
    for name, stream in self.streams.items():
      table[name][np.searchsorted(time, stream.time)] = stream.value
    return time, table
