"""What was measured, as one long vector, and the same vector from a prediction.

Poses are compared as displacements over a fixed horizon, seen from the car at the start of the
horizon: a free run drifts in position and heading without bound under the smallest disturbance,
its displacement over a second does not. The horizon is a choice (0.5 s and 2 s tell different
errors apart), and no restart of the simulation is needed for it.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.segmenting import DEFAULT_CUT, Cut, Stretches, cut_recordings
from qcar_twin.plant import SIGNALS, Prediction
from qcar_twin.recording import Recording
from qcar_twin.vehicle import Vehicle

Array = NDArray[np.float64]

CHANNELS = (
  "motor_speed",
  "speed",
  "accel_x",
  "accel_y",
  "yaw_rate",
  "pose_forward",
  "pose_left",
  "pose_turn",
)
UNITS = {
  "motor_speed": "rad/s",
  "speed": "m/s",
  "accel_x": "m/s^2",
  "accel_y": "m/s^2",
  "yaw_rate": "rad/s",
  "pose_forward": "m",
  "pose_left": "m",
  "pose_turn": "rad",
}
_POSE = slice(0, 3)
_LONG, _SHORT = 1.0, 0.3  # s, horizons with and without a gyro


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
  wheel_radius_times_gear: float
  horizon: float
  _point: NDArray[np.int64]  # flat index of the grid point before each value, (M,)
  _fraction: Array  # weight of the grid point after it, (M,)
  _point_back: NDArray[np.int64]  # the same at the start of a pose horizon
  _fraction_back: Array

  def __len__(self) -> int:
    return len(self.measured)

  @property
  def present(self) -> tuple[str, ...]:
    """Channels that occur."""
    return tuple(CHANNELS[i] for i in np.unique(self.channel))

  @property
  def grid_points(self) -> NDArray[np.int64]:
    """Index of the grid point before each value in the flattened (segment, step) grid, (M,)."""
    return self._point

  def select(self, channel: str) -> NDArray[np.bool_]:
    return self.channel == CHANNELS.index(channel)

  def split(self, count: int) -> tuple["Observations", "Observations"]:
    """The first `count` values and the others, each with the stretches it takes to predict them.

    Raises:
      ValueError: a stretch holds values of both.
    """
    segments, stretch = self.stretches.segments, self._point // (self.stretches.segments.commands.shape[1] + 1)
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
      _point=self._point[rows] - moved,
      _fraction=self._fraction[rows],
      _point_back=self._point_back[rows] - moved,
      _fraction_back=self._fraction_back[rows],
    )

  def predict(self, prediction: Prediction) -> Array:
    """Predicted values of every measured one, (n, M)."""
    n = len(prediction.signals)
    flat = prediction.signals.reshape(n, -1, len(SIGNALS))
    out = np.empty((n, len(self)))
    for name in self.present:
      rows = np.flatnonzero(self.select(name))
      if name.startswith("pose_"):
        out[:, rows] = self._displacement(flat, rows, name)
      else:
        out[:, rows] = self._signal(flat, rows, name)
    return out

  def _signal(self, flat: Array, rows: NDArray[np.int64], name: str) -> Array:
    column = SIGNALS.index("motor_speed" if name == "speed" else name)
    value = _interpolate(flat[:, :, column], self._point[rows], self._fraction[rows])
    if name == "speed":
      value = value * self.wheel_radius_times_gear
      return np.abs(value) if self.unsigned_speed else value
    return value

  def _displacement(self, flat: Array, rows: NDArray[np.int64], name: str) -> Array:
    pose = flat[:, :, _POSE]
    after = _interpolate(pose, self._point[rows], self._fraction[rows])
    before = _interpolate(pose, self._point_back[rows], self._fraction_back[rows])
    return displacement(before, after)[..., ("pose_forward", "pose_left", "pose_turn").index(name)]


def displacement(before: Array, after: Array) -> Array:
  """Displacement seen from the first pose: forward, left [m], turn [rad]; poses (..., 3)."""
  delta = after - before
  cosine, sine = np.cos(before[..., 2]), np.sin(before[..., 2])
  forward = cosine * delta[..., 0] + sine * delta[..., 1]
  left = -sine * delta[..., 0] + cosine * delta[..., 1]
  return np.stack([forward, left, delta[..., 2]], axis=-1)


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
    horizon: time over which poses are differenced, s; 1 s, or 0.3 s where no gyro tells the quick turns.
    pose_rate: poses are thinned to this rate, Hz.
    block: length of an evidence block, s.
  """
  stretches = cut_recordings(recordings, vehicle, cut)
  if horizon is None:
    horizon = _LONG if any("yaw_rate" in r.channels for r in recordings) else _SHORT
  by_name = {recording.name: index for index, recording in enumerate(recordings)}
  grid = stretches.segments.commands.shape[1] + 1
  parts: dict[str, list[Array]] = {k: [] for k in ("v", "c", "r", "t", "p", "f", "pb", "fb")}
  for s, name in enumerate(stretches.segments.recording):
    recording = recordings[by_name[name]]
    place = _Grid(s * grid, float(stretches.segments.offset[s]), cut.period, int(stretches.segments.steps[s]))
    span = (float(stretches.first[s]), float(stretches.last[s]))
    for rows in _segment_rows(recording, place, span, horizon, pose_rate):
      size = len(rows["v"])
      parts["r"].append(np.full(size, by_name[name]))
      for key, value in rows.items():
        parts[key].append(np.broadcast_to(value, size))
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
    wheel_radius_times_gear=vehicle.wheel_radius * vehicle.gear_ratio,
    horizon=horizon,
    _point=joined["p"].astype(np.int64),
    _fraction=joined["f"],
    _point_back=joined["pb"].astype(np.int64),
    _fraction_back=joined["fb"],
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


def _segment_rows(recording: Recording, place: _Grid, span: tuple[float, float], horizon: float, pose_rate: float):
  # the log's first row is the start state itself, not an outcome: scored rows come after it
  low, high = span[0] + 1e-9, span[1] + 1e-9
  for name in CHANNELS[:5]:
    if name in recording.channels and not (name == "speed" and "motor_speed" in recording.channels):
      stream = recording[name]
      keep = (stream.time > low) & (stream.time <= high)
      point, fraction = place.locate(stream.time[keep])
      yield {"v": stream.value[keep], "c": CHANNELS.index(name), "t": stream.time[keep],
             "p": point, "f": fraction, "pb": point, "fb": fraction}  # fmt: skip
  yield from _pose_rows(recording, place, span, horizon, pose_rate)


def _pose_rows(recording: Recording, place: _Grid, span: tuple[float, float], horizon: float, pose_rate: float):
  if "pose_yaw" not in recording.channels:
    return
  planar = "pose_x" in recording.channels and "pose_y" in recording.channels
  yaw = recording["pose_yaw"]
  time = _thin(yaw.time[(yaw.time >= place.offset) & (yaw.time <= span[1] + 1e-9)], pose_rate)
  later = time[time > span[0] + horizon - 1e-9]
  if len(time) < 2 or len(later) == 0:
    return
  earlier = time[np.searchsorted(time, later - horizon - 1e-9).clip(0, len(time) - 1)]
  pose = [np.stack([np.interp(t, recording[c].time, recording[c].value) if c in recording.channels else 0 * t
                    for c in ("pose_x", "pose_y", "pose_yaw")], axis=-1) for t in (earlier, later)]  # fmt: skip
  moved = displacement(*pose)
  point, fraction = place.locate(later)
  back, fraction_back = place.locate(earlier)
  for column, name in enumerate(("pose_forward", "pose_left", "pose_turn")):
    if planar or name == "pose_turn":
      yield {"v": moved[:, column], "c": CHANNELS.index(name), "t": later,
             "p": point, "f": fraction, "pb": back, "fb": fraction_back}  # fmt: skip


def _thin(time: Array, rate: float) -> Array:
  """Every k-th time so that the mean rate is at most `rate`."""
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
  """True if the speed never goes negative although reverse was commanded for a while."""
  lowest = min((r["speed"].value.min() for r in recordings if "speed" in r.channels), default=-1.0)
  return lowest >= 0.0


def noise_of(observations: Observations, levels: Mapping[str, float]) -> Array:
  """Standard deviation of every measured value, (M,), from one level per channel."""
  table = np.array([levels.get(name, np.nan) for name in CHANNELS])
  return table[observations.channel]
