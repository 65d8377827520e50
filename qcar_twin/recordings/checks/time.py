"""Is a recording what it says it is? Time, plausible units, frozen or clipped channels, gaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from qcar_twin.recordings.recording import RecordingError, UnitError

MIN_SAMPLES = 10
LONGEST = 30 * 86400.0  # s that one file may span; a log of days with the nights between, and no damaged clock
_GLITCHES = 2  # jumps of a lost track in an angle, which are no turns; rows that came late, which are no restart
_ROOM = 1.5  # usual steps: between one of a column that has all its samples and two of one that lacks one
_HOUR, _SECOND, _STEPS_LOST = 3600.0, 1.0, 5.0  # s; steps from row to row that a clock misses while it is set
_GAP_STEPS, _GAP_SECONDS = 5.0, 0.25


def gap_limit(step: float) -> float:
  """The longest interval between samples (s) that is not a gap, for a usual interval of `step` s."""
  return max(_GAP_STEPS * step, _GAP_SECONDS)


def check_order(label: str, time: np.ndarray, others: list[np.ndarray]) -> None:
  """Time must be a finite number in every row and never go backwards."""
  bad = np.flatnonzero(~np.isfinite(time))
  if bad.size:
    what = "is infinite" if np.isinf(time[bad[0]]) else "has no value (blank or NaN)"
    raise RecordingError(
      f"{label}: time {what} in row {bad[0] + 1}"
      + (f" and {bad.size - 1} more rows" if bad.size > 1 else "")
      + "; delete those rows"
    )
  back = np.flatnonzero(np.diff(time) < 0.0)
  if back.size:
    row = set_back(time, others) or int(back[0]) + 1
    sort = "set sort = true on time in [channels] where rows were written out of order"
    restarted = _by_hours(time, row) or "split the file where the logger restarted"
    cure = restarted if restarts(time) else _stamped_again(time, row, others) or sort
    raise RecordingError(
      f"{label}: time goes backwards in row {row + 1} ({time[row]:g} s after {time[row - 1]:g} s); {cure}"
    )


def _by_hours(time: np.ndarray, row: int) -> str:
  """What to do with a clock of the day that was set back by whole hours while the log went on; "" where it was not."""
  step = float(np.median(np.diff(time)))
  back = time[row - 1] + step - time[row]
  hours = round(back / _HOUR)
  if time[row] > time[0] - _SECOND or hours < 1 or abs(back - hours * _HOUR) > max(_STEPS_LOST * step, _SECOND):
    return ""
  return (
    f"the clock was set back by {hours} h, as where summer time ends or a time zone is set; split the file before row "
    f"{row + 1}, or add {hours * _HOUR:.0f} s to the times from that row on"
  )


def _stamped_again(time: np.ndarray, row: int, columns: Sequence[np.ndarray]) -> str:
  """What to do where all rows from one on, until time goes on, have stamps that were there; "" where they have not.

  Rows that also hold what those of the same stamps hold were written twice; else the clock was set back.
  """
  end = _caught_up(time, row)
  back = time[row - 1] - time[row]
  if not np.isin(time[row:end], time[:row]).all():
    cure = f"the clock was set back by {back:.3g} s; split the file before row {row + 1}"
    return (
      f"rows {row + 1} to {end} lie between times that were there already: {cure}" if set_back(time, columns) else ""
    )
  before = np.searchsorted(time[:row], time[row:end])
  if all(_equal(column[before], column[row:end]) for column in columns):
    return f"rows {row + 1} to {end} have times that were there already: they were written twice, delete them"
  return (
    f"rows {row + 1} to {end} have times that were there already, and other values: the clock was set back by"
    f" {back:.3g} s; split the file before row {row + 1}"
  )


def set_back(time: np.ndarray, columns: Sequence[np.ndarray]) -> int:
  """The first row from which on a clock that was set back runs through times that have samples already; 0 where none
  does. Rows that were only written late fill the gaps that they left.

  Args:
    columns: of the same rows; a row is a sample of those that are not blank there, as where each message has its own.
  """
  for row in np.flatnonzero(np.diff(time) < 0.0) + 1:
    end = _caught_up(time, int(row))
    if end - row > _GLITCHES and any(_sampled_twice(time, int(row), end, column) for column in columns):
      return int(row)
  return 0


def _caught_up(time: np.ndarray, row: int) -> int:
  """The first row whose time is beyond that of the row before `row`, or their number."""
  return row + int(np.argmax(np.r_[time[row:] > time[row - 1], True]))


def _sampled_twice(time: np.ndarray, row: int, end: int, column: np.ndarray) -> bool:
  """Whether rows from `row` to before `end` lie between earlier samples of a column that leave no room for them."""
  there = column == column if column.dtype != object else np.array([cell is not None for cell in column])
  before, again = np.unique(time[:row][there[:row]]), time[row:end][there[row:end]]
  inside = again[(again > before[0]) & (again < before[-1])] if before.size > _GLITCHES else again[:0]
  if inside.size <= _GLITCHES:
    return False
  after = np.searchsorted(before, inside)
  return bool(np.median(before[after] - before[after - 1]) < _ROOM * np.median(np.diff(before)))


def _equal(one: np.ndarray, other: np.ndarray) -> bool:
  """Whether two parts of a column are the same; a blank equals a blank."""
  return bool(np.all((one == other) | ((one != one) & (other != other))))


def restarts(time: np.ndarray) -> bool:
  """Whether a clock goes back once, to where it began: two drives in one file, whose rows must not be mixed."""
  back = np.flatnonzero(np.diff(time) < 0.0)
  if back.size != 1:
    return False
  row = int(back[0]) + 1
  return bool(time[row] <= time[0] + 1.0) and int(np.sum(time[row:] < time[row - 1])) > _GLITCHES


def check_span(label: str, time: np.ndarray) -> None:
  """One file is no longer than a log of days."""
  longest = float(np.ptp(time)) if time.size else 0.0
  if longest > LONGEST:
    row = int(np.argmax(np.diff(time))) + 1
    raise RecordingError(
      f"{label}: time runs over {longest / 86400.0:.3g} days, with a jump to {time[row]:g} s in row {row + 1}; correct"
      " that row's time, or split the file there"
    )


def check_time_unit(label: str, time: np.ndarray, scale: float = 1.0) -> None:
  """The usual step must be that of a control log in seconds; `scale`: what dataset.toml multiplies the clock by."""
  if time.size < 3:
    return
  step = float(np.median(np.diff(time)))
  if step > 1.0:
    factor, unit = next(
      ((s, u) for s, u in ((1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")) if step * s <= 0.5),
      (1e-9, "ticks"),
    )
    raise UnitError(
      f"{label}: time steps by {step:g}, implausible for seconds; it looks like {unit}",
      f'set time = {{ column = "…", scale = {scale * factor:g} }}',
    )
  if step < 2e-5:
    if scale < 1.0 and step / scale >= 2e-5:
      raise UnitError(
        f"{label}: time steps by {step:g} s, implausibly little", f"take scale = {scale:g} off time in [channels]"
      )
    raise UnitError(
      f"{label}: time steps by {step:g} s, implausibly little; is it in hours or days?",
      "set scale = 3600 or 86400 on time in [channels]",
    )


def turn_of(value: np.ndarray) -> float:
  """The period at which an angle jumps: half a turn or a turn, in rad or in degrees; 0 where it never jumps so.

  Most of the steps beyond half of a period must be within an eighth of it, or within what it turns by elsewhere where
  samples are far apart, up to a quarter; and most of their neighbours that are no jumps below a quarter: an angle that
  turns so fast has neighbours like itself. Where noise carries an angle to and fro over its end, jumps are neighbours.
  """
  step = np.abs(np.diff(value))
  for period in (360.0, 180.0, 2.0 * np.pi, np.pi):
    at = np.flatnonzero(step > 0.5 * period)
    usual = np.percentile(step[step <= 0.5 * period], 99.0) if at.size < step.size else 0.0
    whole = at[np.abs(step[at] - period) < np.clip(usual, 0.125 * period, 0.25 * period)]
    beside = np.setdiff1d(np.clip(np.r_[whole - 1, whole + 1], 0, step.size - 1), at)
    if whole.size > 0.5 * at.size and beside.size and np.median(step[beside]) < 0.25 * period:
      return period
  return 0.0


def check_angle(label: str, channel: str, value: np.ndarray, period: float) -> None:
  """An angle to be unwrapped must be in radians and jump by whole turns."""
  steps = np.abs(np.diff(value))
  jump = steps.max(initial=0.0)
  if period in (360.0, 180.0):
    raise RecordingError(
      f"{label}: {channel} jumps by {jump:g}, implausible for radians; in degrees? set scale = 0.0174533 on {channel} "
      "in [channels]"
    )
  if np.sum(steps > np.pi) > _GLITCHES and not period:
    raise RecordingError(
      f"{label}: {channel} jumps by {jump:g}, which is no whole turn, so that it cannot be unwrapped; set its scale to"
      " the radians in one unit, or wrap = false to keep the jumps"
    )
