"""What a careful person would notice in a recording: frozen and clipped channels, channels that fall silent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.recording import Recording, Stream

_MIN_SAMPLES, _MIN_SECONDS = 10, 0.5  # a frozen stretch has at least these
_MOSTLY = 0.5  # of a recording: what is left of one without so much is no drive any more
_MOVING = 0.1  # m/s, above which a pose must change
_FAR = 0.5  # m that a pose spans where the car moved, beyond what noise and outliers of one at rest do
_POSE, _SPEEDS = ("pose_x", "pose_y", "pose_yaw"), ("speed", "motor_speed")
Spans = Sequence[tuple[float, float]]
_ANSWERS = 0.5  # s, within which every drive has answered a command
_RESTS = 0.03  # of the top speed, below which a car stands
_LEAP = 3.0  # times what one step in twenty is: what a car's inertia does not let it do
_SILENT_STEPS, _SILENT_SECONDS = 10.0, 0.5


@dataclass(frozen=True)
class Runs:
  """Stretches of equal values: indices of their first and last samples (r,), their value and length in samples."""

  first: np.ndarray
  last: np.ndarray
  value: np.ndarray

  @classmethod
  def of(cls, value: np.ndarray) -> Runs:
    first = np.flatnonzero(np.r_[True, value[1:] != value[:-1]])
    return cls(first, np.r_[first[1:], value.size] - 1, value[first])

  @property
  def length(self) -> np.ndarray:
    return self.last - self.first + 1


def find_defects(recording: Recording, lost: Spans = ()) -> list[str]:
  """Warnings about frozen, clipped and silent channels, each with its span in seconds.

  Args:
    lost: spans of samples that were left out and said, s.
  """
  return [*frozen(recording), *clipped(recording), *silent(recording, lost)]


def frozen(recording: Recording) -> list[str]:
  """A channel that repeats one value while the car shows that it cannot: noisy sensors away from rest, speed against
  the drive's command."""
  notes = []
  for channel, stuck in _stuck(recording).items():
    so = "a stuck encoder, or a car held by static friction" if channel in _SPEEDS else "do not trust it there"
    notes.append(_frozen_note(recording, channel, stuck, so))
  return notes


def without_stuck(recording: Recording) -> tuple[Recording, Spans, Spans, list[str]]:
  """The recording without samples at which a sensor stuck, spans of time to leave out whole, s, those of single samples
  that are left out, and notes.

  Where a gyro or a speed stuck nothing says how the car was under way, from which a simulation could begin there. A
  speed that stuck at zero may be a car that was held, where no pose moves: it stays, as does what stuck for most of the
  time, and `frozen` says it.
  """
  streams, out, gone, notes = dict(recording.streams), [], [], []
  for channel, stuck in _stuck(recording).items():
    stream = recording[channel]
    if channel in _SPEEDS:
      stuck = [span for span in stuck if _turned(stream, span) or _moves_unseen(recording, stream, span)]
    if not stuck or sum(b - a for a, b in stuck) > _MOSTLY * (recording.end - recording.start):
      continue
    if channel in (*_SPEEDS, "yaw_rate"):
      out += [(a, float(min(stream.time[stream.time > b], default=recording.end))) for a, b in stuck]
      so = "that part of the recording is left out"
    else:
      kept = ~np.any([(stream.time > a) & (stream.time <= b) for a, b in stuck], axis=0)
      streams[channel] = Stream(stream.time[kept], stream.value[kept])
      gone += stuck
      so = "those samples are left out"
    notes.append(_frozen_note(recording, channel, stuck, f"it stuck there; {so}"))
  return recording.replace(streams=streams), out, gone, notes


def without_clipped(recording: Recording) -> tuple[Recording, Spans, list[str]]:
  """The recording without samples at which a gyro or an accelerometer was at the end of its range, since they say only
  that there was more; their spans, s, and notes."""
  streams, gone, notes = dict(recording.streams), [], []
  for channel, stream in recording.streams.items():
    usual = CHANNELS[channel]
    edges = [edge for edge in _extremes(stream) if _clips(stream, edge)] if usual.noisy and usual.clips else []
    at_edge = np.isin(stream.value, edges)
    if not edges or at_edge.size - at_edge.sum() < _MIN_SAMPLES:
      continue
    runs, time = Runs.of(at_edge.astype(float)), np.r_[recording.start, stream.time, recording.end]
    cut = [(int(a), int(b)) for a, b, v in zip(runs.first, runs.last, runs.value, strict=True) if v]
    spans = [(float(stream.time[a]), float(stream.time[b])) for a, b in cut]
    gone += [(float(time[a]), float(time[b + 2])) for a, b in cut]  # from the sample before to the one after
    streams[channel] = Stream(stream.time[~at_edge], stream.value[~at_edge])
    so = "its sensor range is too small for this run; those samples are left out"
    notes.append(_note(recording, channel, f"is clipped at {' and '.join(f'{edge:g}' for edge in edges)}", spans, so))
  return recording.replace(streams=streams), gone, notes


def outside(spans: Spans, out: Spans) -> list[tuple[float, float]]:
  """Spans, s, without what lies strictly within others."""
  left = list(spans)
  for a, b in out:
    parts = [((first, min(last, a)), (max(first, b), last)) for first, last in left]
    left = [part for pair in parts for part in pair if part[0] < part[1]]
  return left


def _stuck(recording: Recording) -> dict[str, list[tuple[float, float]]]:
  """Spans, s, in which a channel repeats one value although the car shows that it cannot, by channel."""
  stuck = {}
  for channel, stream in recording.streams.items():
    if CHANNELS[channel].noisy:
      bounds = [edge for edge in _extremes(stream) if _clips(stream, edge)]  # a clipped sensor is not a frozen one
      runs = [run for run in _long_runs(stream) if _within(stream, run)[0] not in bounds]
      spans = [run for run in runs if not _at_rest(recording, channel, run)]
      if len(spans) < len(runs):  # it repeats itself at rest: its steps are coarse, or it has no noise
        spans = [run for run in spans if _leaps_away(stream, run)]
    elif channel in _SPEEDS:
      spans = [
        run
        for run in _long_runs(stream)
        if _should_change(recording, stream, run) or _moves_unseen(recording, stream, run)
      ]
    else:
      continue
    if spans:
      stuck[channel] = spans
  return stuck


def stuck_speeds(recording: Recording) -> Spans:
  """Spans, s, in which a measured speed repeats one value although the car shows that it cannot."""
  return [span for channel, spans in _stuck(recording).items() if channel in _SPEEDS for span in spans]


def _frozen_note(recording: Recording, channel: str, stuck: list[tuple[float, float]], so: str) -> str:
  return _note(recording, channel, f"is frozen at {_within(recording[channel], stuck[0])[0]:g}", stuck, so)


def without_lost(recording: Recording) -> tuple[Recording, Spans, list[str]]:
  """The recording without poses that stay the same while the car moves, as where its tracking was lost; the spans of
  those, s, and a note."""
  if not {"pose_x", "pose_y"} <= set(recording.channels) or len(recording["pose_x"]) != len(recording["pose_y"]):
    return recording, [], []
  x = recording["pose_x"]
  lost = [span for span in _long_runs(x, recording["pose_y"]) if _speed_in(recording, span) > _MOVING]
  if not lost:
    return recording, [], []
  so = "the car moved, so tracking was lost there; those samples are left out"
  note = _note(recording, "pose_x, pose_y", f"is frozen at {_within(x, lost[0])[0]:g}", lost, so)
  streams = dict(recording.streams)
  for name in _POSE:
    if name in streams:
      stream = streams[name]
      kept = ~np.any([(stream.time >= a) & (stream.time <= b) for a, b in lost], axis=0)
      streams[name] = Stream(stream.time[kept], stream.value[kept])
  return recording.replace(streams=streams), lost, [note]


def at_range(recording: Recording, channel: str) -> bool:
  """Whether a sensor of the recording has reached the end of its range."""
  stream = recording.streams.get(channel)
  if stream is None or not CHANNELS[channel].clips:
    return False
  return any(_clips(stream, extreme) for extreme in _extremes(stream))


def clipped(recording: Recording) -> list[str]:
  """A finely resolved channel that jumps to its own largest or smallest value and stays for several samples."""
  notes = []
  for channel, stream in recording.streams.items():
    for extreme in _extremes(stream) if CHANNELS[channel].clips else ():
      spans = _clips(stream, extreme)
      if spans:
        notes.append(
          _note(recording, channel, f"is clipped at {extreme:g}", spans, "its sensor range is too small for this run")
        )
  return notes


def silent(recording: Recording, lost: Spans = ()) -> list[str]:
  """A measured channel without samples for long while others go on."""
  notes = []
  for channel, stream in recording.streams.items():
    if CHANNELS[channel].is_command or len(stream) < 3:
      continue
    long = max(_SILENT_STEPS * float(np.median(np.diff(stream.time))), _SILENT_SECONDS)
    there = np.r_[recording.start, stream.time, recording.end]
    spans = [(float(there[row]), float(there[row + 1])) for row in np.flatnonzero(np.diff(there) > long)]
    spans = [(a, b) for a, b in spans if not any(a <= first and last <= b for first, last in lost)]
    ends = [span for span in spans if span[0] == recording.start or span[1] == recording.end]
    for which, so in (
      ([span for span in spans if span not in ends], "it is interpolated there"),
      (ends, "nothing of it is known there"),
    ):
      notes += [_note(recording, channel, "has no sample", which, so)] if which else []
  return notes


def after_start(recording: Recording) -> str:
  """What a time is counted from, where it is not the log's own clock."""
  return f" after the file's start ({recording.origin[0]:.3f})" if recording.origin[0] else ""


def _note(recording: Recording, channel: str, what: str, spans: list[tuple[float, float]], so: str) -> str:
  start, end = spans[0]
  more = f" and in {len(spans) - 1} more places" if len(spans) > 1 else ""
  span = f"from {start:g} s to {end:g} s{after_start(recording)}"
  return f"{recording.file or recording.name}: {channel} {what} {span}{more}; {so}"


def _long_runs(stream: Stream, other: Stream | None = None) -> list[tuple[float, float]]:
  """Spans (s) in which the value repeats for long, by the clock and in samples, and beyond the channel's own habit."""
  value = stream.value if other is None else stream.value + 1j * other.value
  runs = Runs.of(value)
  habit = 5.0 * np.median(runs.length) if runs.length.size > 3 else 0.0
  seconds = stream.time[runs.last] - stream.time[runs.first]
  long = (runs.length >= max(_MIN_SAMPLES, habit)) & (seconds >= _MIN_SECONDS)
  return [
    (float(stream.time[a]), float(stream.time[b])) for a, b in zip(runs.first[long], runs.last[long], strict=True)
  ]


def _within(stream: Stream, span: tuple[float, float]) -> np.ndarray:
  return stream.value[(stream.time >= span[0]) & (stream.time <= span[1])]


def _turned(stream: Stream, span: tuple[float, float]) -> bool:
  """Whether a repeated speed is one of a car that moves: a zero with an offset of its own is one that stands."""
  return float(np.abs(_within(stream, span)).max()) > _RESTS * float(np.abs(stream.value).max())


def _speed_in(recording: Recording, span: tuple[float, float]) -> float:
  """Mean measured speed in a span; infinite for a motor that turns most of the time when only its speed is known, and 0
  when nothing is."""
  if "speed" in recording:
    value = _within(recording["speed"], span)
    return float(np.abs(value).mean()) if value.size else 0.0
  value = _within(recording["motor_speed"], span) if "motor_speed" in recording else np.zeros(0)
  return np.inf if value.size and np.median(np.abs(value)) > 1.0 else 0.0


def _moves_unseen(recording: Recording, stream: Stream, span: tuple[float, float]) -> bool:
  """Whether the car moves by its pose while its speed is zero: a stuck encoder, or a car that somebody carries."""
  if _turned(stream, span) or not {"pose_x", "pose_y"} <= set(recording.channels):
    return False
  x, y = (_within(recording[name], span) for name in ("pose_x", "pose_y"))
  if min(x.size, y.size) < _MIN_SAMPLES:
    return False
  wide = [float(np.percentile(value, 95) - np.percentile(value, 5)) for value in (x, y)]
  return math.hypot(*wide) > max(_FAR, _MOVING * (span[1] - span[0]))


def _at_rest(recording: Recording, channel: str, span: tuple[float, float]) -> bool:
  """A car that stands, or drives straight in a noise-free simulation, may well repeat a value. A steering command in
  the last half second may not have been answered yet."""
  if _speed_in(recording, span) < max(1e-3, _RESTS * _top_speed(recording)):
    return True
  turned = (
    "steering_command" in recording and _within(recording["steering_command"], (span[0], span[1] - _ANSWERS)).any()
  )
  return not turned and channel in ("accel_y", "yaw_rate") and not _within(recording[channel], span).any()


def _top_speed(recording: Recording) -> float:
  return float(np.percentile(np.abs(recording["speed"].value), 99.0)) if "speed" in recording else 0.0


def _should_change(recording: Recording, stream: Stream, span: tuple[float, float]) -> bool:
  """Whether the drive's command says that a repeated speed is a fault: it changes much in the span, or a standing car
  gets more than a moving one usually does."""
  if recording.drive_channel not in recording or recording.drive_channel in recording.derived:
    return False
  command = recording[recording.drive_channel]
  inside = command.at(np.linspace(span[0], span[1], 50))
  if _turned(stream, span):
    much = 0.3 * float(np.ptp(command.value))
    answered = command.at(np.linspace(span[0], max(span[1] - _ANSWERS, span[0]), 50))
    leapt = _leaps_away(stream, span) and float(np.ptp(inside)) > much
    return much > 0.0 and (leapt or float(np.ptp(answered)) > much)
  before = stream.value[stream.time < span[0]]
  if recording.drive_channel == "motor_duty" and np.median(inside) < 0.0 and before.size and before[-1] > 0.0:
    return False  # a controller of a model car brakes by a duty backwards, and holds what it has stopped
  moving = np.abs(stream.value) > 0.1 * np.abs(stream.value).max()
  usual = np.median(np.abs(command.at(stream.time[moving]))) if moving.any() else np.inf
  return bool(usual > 0.0) and float(np.median(np.abs(inside))) >= float(usual)


def _leaps_away(stream: Stream, span: tuple[float, float]) -> bool:
  """Whether a value that stayed goes on by a leap, as a sensor does that stuck while the car did not; so it may have
  where it never goes on."""
  after = stream.value[stream.time > span[1]]
  steps = np.abs(np.diff(stream.value))
  if not after.size or not steps.any():
    return True
  return abs(float(after[0] - _within(stream, span)[0])) > _LEAP * float(np.percentile(steps[steps > 0.0], 95.0))


def _extremes(stream: Stream) -> tuple[float, float]:
  return float(stream.value.max()), float(stream.value.min())


def _clips(stream: Stream, extreme: float) -> list[tuple[float, float]]:
  step = np.abs(np.diff(stream.value))
  moving = step[step > 0.0]
  if moving.size < _MIN_SAMPLES or extreme == 0.0 or np.median(moving) < 4.0 * moving.min():
    return []
  runs = Runs.of(stream.value)
  others = runs.length[runs.value != extreme]
  at = (runs.value == extreme) & (runs.length >= max(4, 3 * np.percentile(others, 99))) & (runs.first >= 2)
  abrupt = np.array(
    [step[max(first - 2, 0) : first].max(initial=0.0) >= 0.3 * np.median(moving) for first in runs.first[at]],
    dtype=bool,
  )
  return [
    (float(stream.time[a]), float(stream.time[b]))
    for a, b in zip(runs.first[at][abrupt], runs.last[at][abrupt], strict=True)
  ]
