"""When each row of a log was taken: its clock's origin, order, repeated stamps, and rows spread between stamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.checks.time import check_order, check_span, check_time_unit, gap_limit, restarts, set_back
from qcar_twin.recordings.formats.table import FEW, Table
from qcar_twin.recordings.manifest import Mapped
from qcar_twin.recordings.recording import RecordingError

_FINE = 0.05  # share of the rows that have a stamp of their own, below which a clock tells nothing, as in `new`
DATED = 1e6  # s, beyond which a clock is rebased: doubles are then 1e-10 s apart, a tenth of the streams' tolerance
_FINEST = 9  # decimals of a second, of a clock in nanoseconds


@dataclass(frozen=True)
class Clock:
  """Sample times of a file's rows, (rows,).

  stamp: as the file has them, s, from the clock's origin.
  row_time: each row's own time, s: rows that share a stamp are spread until the next.
  first: the rows whose stamp is new.
  held: whether a slower publisher's stamp is repeated, so that rows that share one are rows of their own. Where a few
    rows were written twice it is False, and the first of them counts.
  """

  stamp: np.ndarray
  row_time: np.ndarray
  first: np.ndarray
  held: bool


def stamps(table: Table, mapped: Mapped) -> np.ndarray:
  """Each row's time on the log's own clock, s."""
  if mapped.rate is not None:
    return np.arange(table.rows) / mapped.rate
  stamp = mapped.scale * table.number(mapped.column, "time") + mapped.offset
  return np.cumsum(stamp) - stamp[0] if mapped.steps else stamp


def origin_of(stamp: np.ndarray) -> float:
  """What is taken off a log's clock, s: its first stamp where that is a date's, so that a double resolves less of a
  second than the tolerance of its streams; else 0."""
  there = stamp[np.isfinite(stamp)]
  return float(there.min()) if there.size and abs(float(there.min())) > DATED else 0.0


def since_origin(stamp: np.ndarray) -> np.ndarray:
  """Stamps counted from `origin_of` them, s, with the fewest decimals that are the same stamps to what doubles resolve.

  Today's stamps are 2.4e-7 s apart, so that rows every 0.01 s are up to 2.4e-7 s early or late, and a command would be
  taken to come one period after the measurement of its row. With two decimals they are 0.01 s apart again. Stamps of
  finer clocks stay as they are.
  """
  origin = origin_of(stamp)
  if not origin:
    return stamp
  since = stamp - origin
  for decimals in range(_FINEST) if np.isfinite(stamp).all() else ():
    rounded = np.round(since, decimals)
    if np.abs(rounded - since).max() <= np.spacing(np.abs(stamp).max()):
      return rounded
  return since


def in_time_order(table: Table, mapping: Mapping[str, Mapped]) -> tuple[Table, list[str]]:
  """The rows by time, where `sort` says that some were written out of order, and a note how many. Rows of a clock that
  was set back are no such, and stay for the checks to name.

  Raises:
    RecordingError: some stamps are 0 among those of a date.
  """
  stamp = stamps(table, mapping["time"])
  _refuse_unset(table.label, stamp)
  if not mapping["time"].sort:
    return table, []
  late = np.flatnonzero(np.diff(stamp) < 0.0) + 1
  if not late.size or not np.isfinite(stamp).all() or restarts(stamp) or set_back(stamp, _sampled(table, mapping)):
    return table, []
  order = np.argsort(stamp, kind="stable")
  note = f"{table.label}: {late.size} of {table.rows} rows are out of order, first row {late[0] + 1}; sorted by time"
  return table.rows_in(order), [note]


def _sampled(table: Table, mapping: Mapping[str, Mapped]) -> list[np.ndarray]:
  """The columns that channels other than the time are read from."""
  return [table.columns[m.column] for channel, m in mapping.items() if channel != "time" and m.column in table]


def _refuse_unset(label: str, stamp: np.ndarray) -> None:
  """A clock of dates has no 0: the logger ran before its clock was set, or before a simulator published one."""
  unset, others = np.flatnonzero(stamp == 0.0), stamp[stamp != 0.0]
  if unset.size and others.size and np.nanmin(others) > max(DATED, 0.5 * np.nanmax(others)):  # no clock begins at 0
    more = f" and {unset.size - 1} more rows" if unset.size > 1 else ""
    raise RecordingError(
      f"{label}: time is 0 in row {unset[0] + 1}{more} and a date elsewhere: the clock was not set there; delete"
      f" {'those rows' if more else 'that row'}"
    )


def clock_of(table: Table, mapping: Mapping[str, Mapped]) -> tuple[Clock, list[str]]:
  """Row times, after the checks, and a note where a few rows repeat a stamp.

  Repeated stamps pass where each channel has one value at most of a stamp, as where every message has a row of its own,
  where the data set says that a publisher holds values, or where they are few.
  """
  stamp = stamps(table, mapping["time"])
  stamp = since_origin(stamp)
  values = _sampled(table, mapping)
  check_order(table.label, stamp, values)
  first, notes, held = np.r_[True, np.diff(stamp) > 0.0], [], False
  if not first.all() and _complete_each_other(values, first):
    first = np.ones_like(first)
  repeated = [mapped.column for mapped in mapping.values() if mapped.hold]
  again = np.flatnonzero(~first)
  if again.size and not repeated and again.size <= FEW * stamp.size:
    notes.append(
      f"{table.label}: {again.size} of {stamp.size} rows repeat the time of the row before, first row {again[0] + 1}"
      f" ({stamp[again[0]]:.9g} s again); left out"
    )
  elif again.size:
    held = True
    _refuse_repeats(table, stamp, first, repeated)
  check_time_unit(table.label, np.unique(stamp), mapping["time"].scale)
  check_span(table.label, stamp)
  return Clock(stamp, _row_times(stamp, first), first, held), notes


def _complete_each_other(columns: list[np.ndarray], first: np.ndarray) -> bool:
  """Whether rows of one stamp, each block of which begins where `first` is, have one value at most in every column."""
  start = np.flatnonzero(first)
  return all(
    column.dtype != object and np.add.reduceat(~np.isnan(column), start, dtype=int).max() < 2 for column in columns
  )


def _refuse_repeats(table: Table, stamp: np.ndarray, first: np.ndarray, repeated: list[str]) -> None:
  row = int(np.argmin(first))
  text = f"{table.label}: time repeats in row {row + 1} ({stamp[row]:g} s again)"
  if np.sum(first) < _FINE * stamp.size:
    raise RecordingError(
      f"{text}, and has {np.sum(first)} values in {stamp.size} rows, too few to tell when they were: write it with more"
      " digits, or set time = { rate = … } in [channels], in Hz, where rows are evenly spaced"
    )
  read = [channel for channel in table.columns.values() if channel.dtype != object]
  changing = sum(bool((changed(values) & ~first).any()) for values in read)
  if not repeated and changing > 1:  # rows of their own, and stamps of too few digits
    rate = stamp.size / max(float(stamp[-1] - stamp[0]), 1e-9)
    raise RecordingError(
      f"{text} in rows that differ, as where stamps have too few digits: write them with more, or set time = "
      f"{{ rate = {rate:.4g} }} in [channels] where rows are evenly spaced, as {rate:.4g} a second here"
    )
  if not repeated:
    raise RecordingError(
      f"{text}; remove the repeated rows, or set hold = true on the channels that a slower publisher repeats"
    )
  for column in repeated:
    inside = np.flatnonzero(changed(table.columns[column]) & ~first)
    if inside.size:
      raise RecordingError(
        f"{table.label}: time repeats in row {inside[0] + 1} ({stamp[inside[0]]:g} s again) although column "
        f"'{column}', which has hold = true, changes there; remove the repeated rows"
      )


def changed(value: np.ndarray) -> np.ndarray:
  """Whether each row differs from the one before (a blank equals a blank); the first row counts as changed."""
  same = (value[1:] == value[:-1]) | (np.isnan(value[1:]) & np.isnan(value[:-1]))
  return np.r_[True, ~same]


def changes_inside(value: np.ndarray, first: np.ndarray) -> bool:
  return bool((changed(value) & ~first).any())


def _row_times(stamp: np.ndarray, first: np.ndarray) -> np.ndarray:
  """Spread the rows that share a stamp evenly until the next stamp, each at the middle of its share: row i of n at
  stamp + (i + 1/2) / n of the interval. Before a gap, and in the last block, the usual row interval is taken."""
  if first.all():
    return stamp
  start = np.flatnonzero(first)
  count = np.diff(np.r_[start, stamp.size])
  interval = np.diff(np.r_[stamp[start], np.inf])
  usual = np.median((interval / count)[:-1]) if start.size > 1 else 0.0
  limit = gap_limit(np.median(interval[:-1])) if start.size > 1 else 0.0
  share = np.where(interval > limit, usual, interval / count)
  index = np.arange(stamp.size) - np.repeat(start, count)
  return stamp + (index + 0.5) * np.repeat(share, count)
