"""Steps of a command in recordings, and the steady end of the response to each.

A step is a jump of the command that is then held. The response runs from the jump to the next one (or
to the end of the recording); its steady window is the end of it that no longer drifts.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.recording import Recording

Array = NDArray[np.float64]

PERIOD = 0.01  # s, the paper's discretisation of its costs
FILTER_TIME = 0.1  # s, length of the zero-phase moving average
SHORTEST = 0.8  # s, a command held for less is no step
LEAD_IN = 1.0  # s, longest stretch before a step from which starts and biases are read


@dataclasses.dataclass(frozen=True, eq=False)
class Step:
  """The response to one held command.

  Attributes:
    recording, role: where it is from.
    level: held command, V or rad.
    time: s since the step, (T,); negative in the lead-in.
    commands: of the drive (a voltage [V], or what it takes) and steering [rad] held over each period, (T, 2).
    measured: channel -> values on the same grid, (T,).
    steady: rows of the steady window, None if the response is nowhere near its end.
  """

  recording: str
  role: str
  level: float
  time: Array
  commands: Array
  measured: Mapping[str, Array]
  steady: slice | None

  @property
  def first(self) -> int:
    """Row at which the new command begins to act."""
    return int(np.searchsorted(self.time, -0.5 * PERIOD))

  def steady_mean(self, channel: str) -> float:
    return float(np.mean(self.measured[channel][self.steady]))


def moving_average(values: Array, duration: float = FILTER_TIME, period: float = PERIOD) -> Array:
  """Zero-phase moving average over the last axis, over an odd number of samples; shorter at the ends.

  Applied to measurement and model, so that the filter leaves no bias in a comparison.
  """
  half = int(round(0.5 * duration / period))
  length = values.shape[-1]
  total = np.cumsum(np.insert(values, 0, 0.0, axis=-1), axis=-1)
  low = np.maximum(np.arange(length) - half, 0)
  high = np.minimum(np.arange(length) + half + 1, length)
  return (total[..., high] - total[..., low]) / (high - low)


def find_steps(
  recordings: Sequence[Recording], command: str, channel: str, smallest: float, start_at_rest: bool
) -> tuple[Step, ...]:
  """Every step of `command` (the drive's channel, or "steering_command") in some recordings.

  Args:
    channel: the response that has to settle, e.g. "motor_speed".
    smallest: smaller commands are not steps, V or rad.
    start_at_rest: a recording that begins at rest with the command already on is a step from its start.
  """
  steps = []
  for recording in recordings:
    if channel in recording and command in recording:
      steps += _steps_of(recording, command, channel, smallest, start_at_rest)
  return tuple(steps)


def _steps_of(recording: Recording, command: str, channel: str, smallest: float, start_at_rest: bool) -> list[Step]:
  columns = recording.resample(PERIOD)
  _, commands = recording.commands(PERIOD)
  values = commands[:, 1 if command == "steering_command" else 0]
  rows = _logged_rows(columns[channel])
  steps = []
  for jump, begin, end in _plateaus(values[: rows.stop], start_at_rest):
    level = float(np.median(values[begin:end]))
    held = np.std(values[begin:end]) < 0.1 * abs(level)
    if held and abs(level) >= smallest and (end - begin) * PERIOD >= SHORTEST and jump >= rows.start:
      steps.append(_step(recording, columns, commands, level, channel, (max(jump, rows.start), begin, end)))
  return steps


def _logged_rows(values: Array) -> slice:
  """Rows between the first and the last sample."""
  there = np.flatnonzero(np.isfinite(values))
  return slice(int(there[0]), int(there[-1]) + 1) if there.size else slice(0, 0)


def _plateaus(values: Array, start_at_rest: bool) -> list[tuple[int, int, int]]:
  """(first row of the change, first row at the new level, row at which the next change begins) of held stretches.

  Held is what stays within 15 % of the command's range for 0.2 s; a change may be a jump or a quick ramp.
  """
  reach, width = float(np.ptp(values)), int(0.2 / PERIOD)
  if len(values) <= width:
    return []
  quiet = np.ptp(np.lib.stride_tricks.sliding_window_view(values, width), axis=-1) <= 0.15 * reach
  covered = np.convolve(quiet, np.ones(width)) > 0.0  # rows inside a quiet window
  jumps = np.flatnonzero(np.abs(np.diff(values)) > 0.15 * reach) + 1
  edges = np.flatnonzero(np.diff(covered)) + 1
  bounds = np.unique(np.concatenate([[0], edges, jumps, [len(values)]]))
  pairs = [(low, high) for low, high in zip(bounds[:-1], bounds[1:], strict=True) if covered[low]]
  spans = [_sharpened(values, int(low), int(high), 0.02 * reach) for low, high in pairs]
  starts = [(0, begin) for begin, _ in spans[:1] if start_at_rest]
  starts += [(end, begin) for (_, end), (begin, _) in zip(spans[:-1], spans[1:], strict=True)]
  ends = [end for _, end in (spans if start_at_rest else spans[1:])]
  return [(jump, begin, end) for (jump, begin), end in zip(starts, ends, strict=True)]


def _sharpened(values: Array, low: int, high: int, tolerance: float) -> tuple[int, int]:
  """First row of a held stretch at its level, and the first after it that leaves the level."""
  at_level = np.flatnonzero(np.abs(values[low:high] - np.median(values[low:high])) <= tolerance)
  return low + int(at_level[0]), low + int(at_level[-1]) + 1


def _step(
  recording: Recording,
  columns: Mapping[str, Array],
  commands: Array,
  level: float,
  channel: str,
  rows: tuple[int, int, int],
) -> Step:
  jump, begin, end = rows
  first = max(0, jump - int(LEAD_IN / PERIOD))
  window = slice(first, end)
  measured = {name: values[window] for name, values in columns.items() if name != "time"}
  settled = settled_rows(columns[channel][begin:end])
  steady = None if settled is None else slice(settled + begin - first, end - first)
  time = PERIOD * np.arange(first - jump, end - jump, dtype=np.float64)
  return Step(recording.name, recording.role, level, time, commands[window], measured, steady)


def settled_rows(values: Array, tight: float = 0.004, loose: float = 0.08) -> int | None:
  """First row of the steady end of a response; None if it is nowhere near its end.

  The longest end whose two halves have means within `tight` of each other (relative, on top of what the
  noise from sample to sample explains), of those that begin after 30, 40, ... 80 % of the response; else
  its last 40 % if the halves agree within `loose`.
  """
  noise = float(np.std(np.diff(values)))  # sqrt(2) of one sample's
  for share, limit in [*((s, tight) for s in np.arange(0.3, 0.81, 0.1)), (0.6, loose)]:
    begin = int(share * len(values))
    early, late = np.array_split(values[begin:], 2)
    allowed = limit * abs(float(np.mean(values[begin:]))) + 3.0 * noise / np.sqrt(max(len(late), 1))
    if len(early) >= 0.15 / PERIOD and abs(np.mean(early) - np.mean(late)) <= allowed:
      return begin
  return None


def standard_error(values: Array, blocks: int = 4) -> float:
  """Standard error of the mean of correlated samples, from the means of a few blocks."""
  means = [float(np.mean(block)) for block in np.array_split(values, blocks)]
  return float(np.std(means, ddof=1) / np.sqrt(blocks))
