"""What was measured, as one long vector, and the same vector from a prediction.

Poses are compared as displacements over a fixed horizon, seen from the car at the start of the
horizon: a free run drifts in position and heading without bound under the smallest disturbance,
its displacement over a second does not. The horizon is a choice (0.5 s and 2 s tell different
errors apart), and no restart of the simulation is needed for it.
"""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.noise_floor import driving_noise
from calibration.fitting.residual_channels import CHANNELS, POSE, RESIDUALS, UNITS, ResidualChannel, compared_in
from calibration.fitting.windows import DEFAULT_CUT, Cut, Stretches, cut_recordings
from qcar_twin.plant import SIGNALS, Prediction, signal_index
from qcar_twin.recordings.completed import speed_window
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

__all__ = ["CHANNELS", "UNITS", "Observations", "observe"]
Rows = dict[str, Any]  # values, channel, times, grid points and fractions of some rows
_LONG, _SHORT = 1.0, 0.3  # s, horizons with and without a gyro
_POSE = slice(signal_index(POSE[0]), signal_index(POSE[-1]) + 1)
_PLACE = slice(_POSE.start, _POSE.start + 2)
_NOW, _BEFORE, _HALFWAY, _AFTER = 0, 1, 2, 2  # moments of a value
# of a window, from its middle: two poses so far apart give the slope that a parabola through all of them has there, of
# ways that a cubic follows (the mean of t^4 over that of t^2, t in windows from -1/2 to 1/2, is 3/20)
_REACH = float(np.sqrt(3.0 / 20.0))
_TELLS = 20.0  # times a place's noise, at which a way's direction is known to 0.07 rad


@dataclasses.dataclass(frozen=True)
class Observations:
  """M measured values in a fixed order.

  Attributes:
    stretches: what to simulate.
    measured: values, (M,).
    channel: index into CHANNELS, (M,).
    recording: index of the recording, (M,).
    block: running number of a block of about three seconds of one recording, (M,).
    time: recording time of each value, s, (M,).
    names: recording names.
    unsigned_speed: True if the log's speed never carries a sign.
    vehicle: numbers of the car, which some channels are predicted with.
    horizon: time over which poses are differenced, s.
  """

  stretches: Stretches
  measured: Array
  channel: NDArray[np.int64]
  recording: NDArray[np.int64]
  block: NDArray[np.int64]
  time: Array
  names: tuple[str, ...]
  unsigned_speed: bool
  vehicle: Vehicle
  horizon: float
  _points: NDArray[np.int64]  # flat index of the grid point before each value, a horizon earlier, half of it, (M, 3)
  _fractions: Array  # weight of the grid point after it, (M, 3)

  def __len__(self) -> int:
    return len(self.measured)

  @functools.cached_property
  def present(self) -> tuple[str, ...]:
    """Channels that occur."""
    return tuple(CHANNELS[i] for i in np.unique(self.channel))

  @functools.cached_property
  def _rows(self) -> dict[str, NDArray[np.intp]]:
    """Where the values of each channel are."""
    return {name: np.flatnonzero(self.select(name)) for name in self.present}

  @property
  def grid_points(self) -> NDArray[np.int64]:
    """Index of the grid point before each value in the flattened (segment, step) grid, (M,)."""
    return self._points[:, 0]

  @property
  def stretch(self) -> NDArray[np.int64]:
    """Index of the simulated stretch of each value, (M,)."""
    return self.grid_points // (self.stretches.segments.commands.shape[1] + 1)

  def select(self, channel: str) -> NDArray[np.bool_]:
    return self.channel == CHANNELS.index(channel)

  def split(self, count: int) -> tuple["Observations", "Observations"]:
    """The first `count` values and the others, each with the stretches it takes to predict them.

    Raises:
      ValueError: a stretch holds values of both.
    """
    segments, stretch = self.stretches.segments, self.stretch
    first = int(stretch[count]) if count < len(self) else len(segments)
    if np.any(stretch[:count] >= first) or np.any(stretch[count:] < first):
      raise ValueError(
        f"value {count} does not begin a stretch of its own; sort recordings by role before observing them"
      )
    return self._part(slice(0, count), slice(0, first)), self._part(slice(count, None), slice(first, len(segments)))

  def _part(self, rows: slice, which: slice) -> "Observations":
    stretches, moved = self.stretches, which.start * (self.stretches.segments.commands.shape[1] + 1)
    return dataclasses.replace(
      self,
      stretches=Stretches(stretches.segments[which], stretches.first[which], stretches.last[which]),
      **{name: getattr(self, name)[rows] for name in ("measured", "channel", "recording", "block", "time")},
      _points=self._points[rows] - moved,
      _fractions=self._fractions[rows],
    )

  def some(self, kept: NDArray[np.intp]) -> "Observations":
    """The values of some stretches, whose indices rise, with those stretches alone."""
    stretches, stretch, grid = self.stretches, self.stretch, self.stretches.segments.commands.shape[1] + 1
    rows = np.flatnonzero(np.isin(stretch, kept))
    moved = (stretch[rows] - np.searchsorted(kept, stretch[rows])) * grid
    return dataclasses.replace(
      self,
      stretches=Stretches(stretches.segments[kept], stretches.first[kept], stretches.last[kept]),
      **{name: getattr(self, name)[rows] for name in ("measured", "channel", "recording", "block", "time")},
      _points=self._points[rows] - moved[:, None],
      _fractions=self._fractions[rows],
    )

  def predict(self, prediction: Prediction) -> Array:
    """Predicted values of every measured one, (n, M)."""
    n = len(prediction.signals)
    flat = prediction.signals.reshape(n, -1, len(SIGNALS))
    out = np.empty((n, len(self)))
    for name, rows in self._rows.items():
      out[:, rows] = self._predict(RESIDUALS[name], flat, rows)
    return out

  def _predict(self, channel: ResidualChannel, flat: Array, rows: NDArray[np.int64]) -> Array:
    at = lambda values, moment: _interpolate(values, self._points[rows, moment], self._fractions[rows, moment])
    if channel.displacement is not None:
      pose = flat[:, :, _POSE]
      return channel.displacement(at(pose, _BEFORE), at(pose, _NOW))
    if channel.path is not None:
      place = flat[:, :, _PLACE]
      return channel.path(at(place, _BEFORE), at(place, _HALFWAY), at(place, _NOW))
    if channel.way is not None:
      pose, ends = flat[:, :, _POSE], self._points[rows] + self._fractions[rows]
      duration = (ends[:, _AFTER] - ends[:, _BEFORE]) * self.stretches.segments.period
      value = channel.way(at(pose, _BEFORE), at(pose, _AFTER)) / duration
    else:
      assert channel.model is not None
      value = channel.model(lambda name: at(flat[:, :, signal_index(name)], _NOW), self.vehicle)
    return np.abs(value) if channel.may_lose_sign and self.unsigned_speed else value


def observe(
  recordings: Sequence[Recording],
  vehicle: Vehicle,
  cut: Cut = DEFAULT_CUT,
  horizon: float | None = None,
  pose_rate: float = 10.0,
  block: float = 3.0,
) -> Observations:
  """Collect the measured values of recordings.

  Args:
    recordings: what was driven.
    vehicle: numbers of the car.
    cut: how the recordings are cut for simulation.
    horizon: time over which poses are differenced, s; 1 s, or 0.3 s where headings have to tell the quick turns.
    pose_rate: poses are thinned to this rate, Hz.
    block: length of an evidence block, s.
  """
  stretches = cut_recordings(recordings, vehicle, cut)
  if horizon is None:
    gyro, heading = (any(name in r for r in recordings) for name in ("yaw_rate", "pose_yaw"))
    horizon = _SHORT if heading and not gyro else _LONG
  by_name = {recording.name: index for index, recording in enumerate(recordings)}
  grid = stretches.segments.commands.shape[1] + 1
  parts: dict[str, list[Array]] = {k: [] for k in ("v", "c", "r", "t", "p", "f")}
  for s, name in enumerate(stretches.segments.recording):
    recording = recordings[by_name[name]]
    place = _Grid(s * grid, float(stretches.segments.offset[s]), cut.period, int(stretches.segments.steps[s]))
    span = (float(stretches.first[s]), float(stretches.last[s]))
    for rows in _segment_rows(recording, place, span, horizon, pose_rate):
      size = len(rows["v"])
      parts["r"].append(np.full(size, by_name[name]))
      for key, value in rows.items():
        parts[key].append(np.broadcast_to(value, (size, *np.shape(value)[1:])))
  joined = {key: np.concatenate(value) for key, value in parts.items()}
  return Observations(
    stretches=stretches,
    measured=joined["v"],
    channel=joined["c"].astype(np.int64),
    recording=joined["r"].astype(np.int64),
    block=_blocks(joined["r"], joined["t"], recordings, block),
    time=joined["t"],
    names=tuple(r.name for r in recordings),
    unsigned_speed=_unsigned(recordings),
    vehicle=vehicle,
    horizon=horizon,
    _points=joined["p"].astype(np.int64),
    _fractions=joined["f"],
  )


@dataclasses.dataclass(frozen=True)
class _Grid:
  """Where a segment's control grid lies in the flattened prediction."""

  base: int
  offset: float
  period: float
  steps: int

  def locate(self, time: Array) -> tuple[Array, Array]:
    position = np.clip((time - self.offset) / self.period, 0.0, self.steps)
    point = np.minimum(position.astype(np.int64), self.steps - 1)
    return self.base + point, position - point


def _segment_rows(
  recording: Recording, place: _Grid, span: tuple[float, float], horizon: float, pose_rate: float
) -> Iterator[Rows]:
  # the log's first row is the start state itself, not an outcome: scored rows come after it
  low, high = span[0] + 1e-9, span[1] + 1e-9
  compared = compared_in(recording)
  for channel in compared:
    if channel.is_direct:
      stream = recording[channel.needs[0]]
      time, reach = stream.time, _REACH * speed_window(stream) if channel.way is not None else 0.0
      keep = (time > low) & (time <= high) & (time - reach >= place.offset) & (time + reach <= high)
      now = time[keep]
      yield _rows(channel, stream.value[keep], place, [now, now - reach, now + reach])
  displaced = [c for c in compared if not c.is_direct]
  if displaced:
    yield from _pose_rows(displaced, recording, place, span, horizon, pose_rate)


def _pose_rows(
  channels: Sequence[ResidualChannel],
  recording: Recording,
  place: _Grid,
  span: tuple[float, float],
  horizon: float,
  pose_rate: float,
) -> Iterator[Rows]:
  shown = recording["pose_yaw" if "pose_yaw" in recording else "pose_x"]
  time = _thin(shown.time[(shown.time >= place.offset) & (shown.time <= span[1] + 1e-9)], pose_rate)
  later = time[time > span[0] + horizon - 1e-9]
  if len(time) < 2 or len(later) == 0:
    return
  ago = lambda duration: time[np.searchsorted(time, later - duration - 1e-9).clip(0, len(time) - 1)]
  times = [later, ago(horizon), ago(0.5 * horizon)]
  now, before, halfway = (_measured_pose(recording, t) for t in times)
  for channel in channels:
    if channel.displacement is not None:
      yield _rows(channel, channel.displacement(before, now), place, times)
    elif channel.path is not None:
      told = np.linalg.norm((halfway - before)[:, :2], axis=1) > _TELLS * _place_noise(recording)
      value = channel.path(*(pose[told, :2] for pose in (before, halfway, now)))
      yield _rows(channel, value, place, [t[told] for t in times])


def _rows(channel: ResidualChannel, value: Array, place: _Grid, times: Sequence[Array]) -> Rows:
  """Values of a channel at times, s, with those a horizon and half of it earlier; each (k,)."""
  points, fractions = zip(*(place.locate(t) for t in times), strict=True)
  return {
    "v": value,
    "c": CHANNELS.index(channel.name),
    "t": times[_NOW],
    "p": np.stack(points, axis=1),
    "f": np.stack(fractions, axis=1),
  }


def _place_noise(recording: Recording) -> float:
  """White noise of the place along one direction, m; 0 where none can be told."""
  white = driving_noise([recording])
  return max(white.get("pose_x", 0.0), white.get("pose_y", 0.0))


def _measured_pose(recording: Recording, time: Array) -> Array:
  """x, y [m] and yaw [rad] at some times, s, (k, 3); 0 for one that is not measured."""
  at = lambda stream: np.interp(time, stream.time, stream.value)
  return np.stack([at(recording[name]) if name in recording else 0.0 * time for name in POSE], axis=-1)


def _thin(time: Array, rate: float) -> Array:
  """Every k-th time, k the whole number nearest to the sampling rate over `rate` [Hz]."""
  if len(time) < 3:
    return time
  return time[:: max(1, int(round(rate**-1 / np.median(np.diff(time)))))]


def _interpolate(values: Array, point: NDArray[np.int64], fraction: Array) -> Array:
  """Linear interpolation along the flattened grid axis 1: values (n, G) or (n, G, k)."""
  weight = fraction if values.ndim == 2 else fraction[:, None]
  return values[:, point] * (1.0 - weight) + values[:, point + 1] * weight


def _blocks(recording: Array, time: Array, recordings: Sequence[Recording], length: float) -> NDArray[np.int64]:
  number, first = np.zeros(len(time), dtype=np.int64), 0
  for index, item in enumerate(recordings):
    rows = recording == index
    count = max(1, int(round(item.duration / length)))
    local = np.floor((time[rows] - item.start) / max(item.duration, 1e-9) * count).astype(np.int64)
    number[rows] = first + np.clip(local, 0, count - 1)
    first += count
  return number


def _unsigned(recordings: Sequence[Recording]) -> bool:
  """True if a sensor that may lose the speed's sign gives none below 0 in any recording; False where there is none.

  No command is looked at: a log that only goes forward passes for unsigned, too, and predicted speeds are then compared
  by size.
  """
  lossy = [r[c.needs[0]] for c in RESIDUALS.values() if c.may_lose_sign for r in recordings if c.needs[0] in r]
  return min((stream.value.min() for stream in lossy), default=-1.0) >= 0.0


def fitted_count(observations: Observations, recordings: Sequence[Recording]) -> int:
  """How many values, from the front, belong to recordings that are fitted."""
  judging = [i for i, r in enumerate(recordings) if r.role == "validate"]
  if len(judging) == len(recordings):
    raise ValueError('no recording has the role "identify"; give at least one that role in dataset.toml')
  return int(np.sum(~np.isin(observations.recording, judging)))
