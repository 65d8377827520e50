"""Recordings as windows of a tenth of a second, each with its readings and the measured motion it starts from.

A window is so short that what pushes the car unforeseen is a constant force in it; only windows of this length leave
white residuals. Poses are compared as they are, not as displacements: where the car is belongs to a window's start.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.fitting.residual_channels import POSE, RESIDUALS
from calibration.fitting.windows import Cut, driven, measured_start, pose_on, shift_commands, wheel_angle_on
from calibration.likelihood.stray import stray_poses
from qcar_twin.kinematics import motor_speed
from qcar_twin.plant import MOTION, START, Segments, signal_index
from qcar_twin.recordings.dataset import in_order
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

EVERY = 10  # control periods of a window
LONGEST, WARM_UP = 200, 5  # windows of a stretch that is simulated in one go, and unscored ones before it
BLOCK = 30  # windows of a block that is left out or flipped as a whole
POSE_EVERY = 0.1  # s between poses that are used: closer ones say the same again


@dataclasses.dataclass(frozen=True)
class Readings:
  """J windows of m places for readings each.

  Attributes:
    segments: S stretches to simulate, with room for K windows each.
    window: index of each stretch's windows among the J, (S, K).
    stretch, first_period: which stretch scores a window, and its first control period there, (J,).
    measured: (J, m); used: whether a place holds a reading, (J, m).
    channel: of each place, index into `channels`, (m,).
    point, fraction: control period before each reading in its stretch, and how far it lies into the next, (J, m).
    starts: measured motions at the windows' beginnings, (J, 7), in the order of MOTION.
    begins: whether a window begins a chain, (J,); recording: index, (J,); block: of about three seconds, (J,).
    time: recording time at the window's beginning, s, (J,).
    period: s.
  """

  segments: Segments
  window: NDArray[np.intp]
  stretch: NDArray[np.intp]
  first_period: NDArray[np.intp]
  measured: Array
  used: NDArray[np.bool_]
  channels: tuple[str, ...]
  channel: NDArray[np.intp]
  point: NDArray[np.intp]
  fraction: Array
  starts: Array
  begins: NDArray[np.bool_]
  recording: NDArray[np.intp]
  block: NDArray[np.intp]
  time: Array
  names: tuple[str, ...]
  vehicle: Vehicle

  def __len__(self) -> int:
    return len(self.measured)

  def predict(self, signals: Array) -> Array:
    """Predicted readings (n, J, m) from signals (n, S, T + 1, 10)."""
    at, share = (self.stretch[:, None], self.point), self.fraction
    on_grid = not np.any(share)
    out = np.zeros((len(signals), *self.measured.shape))
    for c, name in enumerate(self.channels):
      columns = np.flatnonzero(self.channel == c)
      point = self.point[:, columns]

      def signal(which: str, point: NDArray[np.intp] = point, columns: NDArray[np.intp] = columns) -> Array:
        plane = signals[..., signal_index(which)]
        before = plane[:, at[0], point]
        if on_grid:
          return before
        weight = share[:, columns]
        return before * (1.0 - weight) + plane[:, at[0], np.minimum(point + 1, plane.shape[2] - 1)] * weight

      model = None if name in POSE else RESIDUALS[name].model
      out[:, :, columns] = signal(name) if model is None else model(signal, self.vehicle)
    return out

  def ends(self, signals: Array) -> Array:
    """Motions at the windows' ends, (n, J, 7)."""
    last = np.minimum(self.first_period + EVERY, self.segments.steps[self.stretch])
    return signals[:, self.stretch, last][..., [signal_index(name) for name in MOTION]]

  def begun(self, starts: Array) -> Array:
    """Starts (J, 7) as a simulation takes them, (S, K, 7)."""
    return starts[self.window]


@dataclasses.dataclass
class _Stretch:
  recording: int
  low: int  # first scored window
  high: int
  warm: int  # unscored windows before


def read(recordings: Sequence[Recording], vehicle: Vehicle, cut: Cut) -> Readings:
  """Windows of recordings.

  Args:
    recordings: in the order they were driven.
    vehicle: numbers of the car.
    cut: control period, command timing, and seconds of driving that are kept at most.

  Raises:
    ValueError: no recording is long enough.
  """
  logs = [_log(r, vehicle, cut) for r in recordings]
  stretches = _stretches([len(log["commands"]) for log in logs], cut)
  if not stretches:
    raise ValueError(f"no recording is long enough for a window of {EVERY * cut.period:g} s of driving")
  present = [c for c in (*RESIDUALS, *POSE) if any(_compared(c, r) for r in recordings)]
  segments, window = _segments(recordings, logs, stretches, cut)
  rows = _rows(recordings, logs, stretches, present, cut.period)
  owner = np.concatenate([np.full(s.high - s.low, i) for i, s in enumerate(stretches)])
  number = np.concatenate([np.arange(s.low, s.high) for s in stretches])
  recording = np.array([s.recording for s in stretches])[owner]
  begins = np.append(True, (np.diff(recording) != 0) | (np.diff(number) != 1))
  shift = np.array([(s.low - s.warm) * EVERY for s in stretches])[owner]
  return Readings(
    segments=segments,
    window=window,
    stretch=owner,
    first_period=number * EVERY - shift,
    measured=rows["measured"],
    used=rows["used"].astype(bool),
    channels=tuple(present),
    channel=rows["channel"].astype(np.intp),
    point=rows["point"].astype(np.intp) - np.where(rows["used"], shift[:, None], 0),
    fraction=rows["fraction"],
    starts=np.concatenate([logs[s.recording]["starts"][s.low : s.high] for s in stretches]),
    begins=begins,
    recording=recording,
    block=np.cumsum(begins | (_since(begins) % BLOCK == 0)) - 1,
    time=np.concatenate([logs[s.recording]["time"][s.low * EVERY : s.high * EVERY : EVERY] for s in stretches]),
    names=tuple(r.name for r in recordings),
    vehicle=vehicle,
  )


def _since(begins: NDArray[np.bool_]) -> NDArray[np.intp]:
  """How many windows lie between each and the beginning of its chain."""
  index = np.arange(len(begins))
  return index - np.maximum.accumulate(np.where(begins, index, 0))


def _compared(channel: str, recording: Recording) -> bool:
  if channel in POSE:
    return set(POSE) <= recording.streams.keys()
  record = RESIDUALS[channel]
  return record.model is not None and record.needs[0] in recording and record.instead not in recording


def _log(recording: Recording, vehicle: Vehicle, cut: Cut) -> dict[str, Array]:
  time, commands = driven(recording, vehicle, cut.period)
  grid = np.append(time, time[-1] + cut.period)
  starts = []
  for k in range(0, len(time), EVERY):
    measured = measured_start(recording, float(time[k]), vehicle, commands[k, 1], k == 0)
    s = dict(zip(START, measured, strict=True)) | {"motor_speed": motor_speed(measured[3], vehicle)}
    starts.append([s[name] for name in MOTION])
  return {
    "time": time,
    "commands": shift_commands(commands, cut.command_shift),
    "pose": pose_on(recording, grid),
    "wheel_angle": wheel_angle_on(recording, grid, vehicle),
    "starts": np.array(starts, dtype=np.float64),
  }


def _stretches(lengths: Sequence[int], cut: Cut) -> list[_Stretch]:
  """Recordings in pieces; evenly spread ones where there is more driving than is kept."""
  found = []
  for i, length in enumerate(lengths):
    count = -(-length // EVERY)
    if length < 2 * EVERY:
      continue
    edges = np.linspace(0, count, -(-count // LONGEST) + 1).round().astype(int)
    found += [_Stretch(i, a, b, min(WARM_UP, a)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
  driving = sum(s.high - s.low for s in found) * EVERY * cut.period
  if driving > cut.most:
    kept = max(1, int(len(found) * cut.most / driving))
    found = [found[i] for i in np.linspace(0, len(found) - 1, kept).round().astype(int)]
    found = [dataclasses.replace(s, warm=s.warm if any(o.high == s.low and o.recording == s.recording for o in found)
                                 else 0) for s in found]  # fmt: skip
  return found


def _segments(
  recordings: Sequence[Recording], logs: Sequence[dict[str, Array]], stretches: Sequence[_Stretch], cut: Cut
) -> tuple[Segments, NDArray[np.intp]]:
  history = [np.array(r.before) for r in in_order(recordings)]
  windows = max(s.high - s.low + s.warm for s in stretches)
  longest, made = windows * EVERY, {name: [] for name in ("c", "s", "n", "o", "h", "p", "w", "i")}
  first = 0
  pad = lambda a, n: np.concatenate([a, np.repeat(a[-1:], n - len(a), axis=0)])
  for s in stretches:
    log, begin, end = logs[s.recording], (s.low - s.warm) * EVERY, s.high * EVERY
    commands = log["commands"][begin:end]
    x = dict(zip(MOTION, log["starts"][begin // EVERY], strict=True)) | {"steering_angle": commands[0, 1]}
    made["c"].append(pad(commands, longest))
    made["s"].append([x[name] for name in START])
    made["n"].append(len(commands))
    made["o"].append(log["time"][begin])
    spent = [begin * cut.period, float(np.sum(log["commands"][:begin, 0] ** 2)) * cut.period]
    made["h"].append(history[s.recording] + spent)
    made["p"].append(pad(log["pose"][begin : end + 1], longest + 1))
    made["w"].append(pad(log["wheel_angle"][begin : end + 1], longest + 1))
    index = np.arange(first - s.warm, first + s.high - s.low)
    made["i"].append(pad(index, windows))
    first += s.high - s.low
  stacked = {name: np.array(value) for name, value in made.items()}
  names = tuple(recordings[s.recording].name for s in stretches)
  segments = Segments(
    stacked["c"], stacked["s"], stacked["n"].astype(np.int64), cut.period, names, stacked["o"], stacked["h"],
    stacked["p"], stacked["w"],
  )  # fmt: skip
  return segments, stacked["i"].astype(np.intp)


def _rows(
  recordings: Sequence[Recording], logs: Sequence[dict[str, Array]], stretches: Sequence[_Stretch],
  channels: Sequence[str], period: float,
) -> dict[str, Array]:  # fmt: skip
  """Readings by window, all channels beside each other; each with as many places as its fullest window needs."""
  total = sum(s.high - s.low for s in stretches)
  firsts = np.cumsum([0] + [s.high - s.low for s in stretches])
  parts: dict[str, list[Array]] = {name: [] for name in ("measured", "used", "point", "fraction", "channel")}
  strays = [stray_poses(r) for r in recordings]
  for c, name in enumerate(channels):
    found = []  # window, value, point, fraction
    for i, s in enumerate(stretches):
      recording, log = recordings[s.recording], logs[s.recording]
      if not _compared(name, recording):
        continue
      stream = recording[name if name in POSE else RESIDUALS[name].needs[0]]
      time, value = stream.time, stream.value
      if name in POSE:
        time, value = _sparse(time[~strays[s.recording]], value[~strays[s.recording]])
      position = (time - log["time"][0]) / period
      position = np.where(np.abs(position - np.round(position)) < 1e-6, np.round(position), position)
      window = np.ceil(position / EVERY).astype(int) - 1
      keep = (window >= s.low) & (window < s.high) & (position <= len(log["commands"]))
      point = np.floor(position[keep])
      found.append(np.column_stack([firsts[i] + window[keep] - s.low, value[keep], point, position[keep] - point]))
    table = np.concatenate(found)
    window = table[:, 0].astype(int)
    place = np.arange(len(window)) - np.searchsorted(window, window)
    places = int(place.max(initial=0)) + 1
    for key, column in (("measured", 1), ("point", 2), ("fraction", 3)):
      grid = np.zeros((total, places))
      grid[window, place] = table[:, column]
      parts[key].append(grid)
    used = np.zeros((total, places), dtype=bool)
    used[window, place] = True
    parts["used"].append(used)
    parts["channel"].append(np.full(places, c))
  return {key: np.concatenate(value, axis=-1) for key, value in parts.items()}


def _sparse(time: Array, value: Array) -> tuple[Array, Array]:
  """At most one sample per interval of POSE_EVERY."""
  if len(time) < 2:
    return time, value
  every = max(1, round(POSE_EVERY / float(np.median(np.diff(time)))))
  return time[::every], value[::every]
