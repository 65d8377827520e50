"""From the columns of a log to streams of channels: scale, offset, gate, repeated samples, unwrapped angles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.checks.dropouts import without_dropouts
from qcar_twin.recordings.checks.time import (
  check_angle,
  check_order,
  check_span,
  check_time_unit,
  gap_limit,
  restarts,
  turn_of,
)
from qcar_twin.recordings.formats.table import NO_ROWS, Table
from qcar_twin.recordings.formats.unsigned import signs_said
from qcar_twin.recordings.manifest import Mapped
from qcar_twin.recordings.recording import RecordingError, Stream, UnknownChannelError, nearest

_FINE = 0.05  # share of the rows that have a stamp of their own, below which a clock tells nothing, as in `new`
_COARSE = 0.05  # a stated prior: share of rows that repeat a stamp, below which they are rows written twice
_FEW_NANS = 0.05  # formats without blanks: rarer NaNs in a command are faults, commoner ones are an asynchronous stream
DATED = 1e6  # s, beyond which a clock is rebased: doubles are then 1e-10 s apart, a tenth of the streams' tolerance
_FINEST = 9  # decimals of a second, of a clock in nanoseconds
_MIN_RUNS = 5  # runs of equal values that make a publisher's rate sure


@dataclass(frozen=True)
class Clock:
  """Sample times of a file's rows. `first` marks the rows where a slower publisher's stamp is new; `row_time` is each
  row's own time.
  """

  stamp: np.ndarray
  row_time: np.ndarray
  first: np.ndarray

  @property
  def repeats(self) -> bool:
    """Whether some rows share a stamp."""
    return not bool(self.first.all())


def resolve(table: Table, mapping: Mapping[str, Mapped]) -> dict[str, Mapped]:
  """The mapping that applies to one file: [channels], then columns that already have a channel's name.

  Without any [channels] every column claims to be a channel, so a near miss is an error. An optional channel whose
  column this file lacks is left out; a missing clock, drive command or gate is an error.
  """
  if table.headless and not mapping:
    raise RecordingError(
      f"{table.label}: the first line holds numbers, not column names; add a header line such as "
      'time,motor_voltage,speed, or columns = ["time", …] with a name for each column to dataset.toml'
    )
  used = {mapped.column for mapped in mapping.values()}
  resolved = {
    channel: Mapped(channel)
    for channel in CHANNELS
    if channel in table and channel not in mapping and channel not in used
  }
  if not mapping:
    for column in table.columns:
      _refuse_near_miss(table, column)
  for channel, mapped in mapping.items():
    if mapped.column in table or channel in ("time", _drive(mapping)):
      resolved[channel] = mapped
  if "time" not in resolved:
    cure = 'add time = { column = "…" } to [channels], or time = { rate = … } in Hz where every row is one step'
    raise RecordingError(
      f"{table.label}: needed channel 'time' is missing; {cure}. Columns that exist: {table.listing()}"
    )
  if not resolved.keys() & {*DRIVE_COMMANDS, "steering_command"}:
    others = ", ".join(DRIVE_COMMANDS[1:])
    raise RecordingError(
      f"{table.label}: needed channel 'motor_voltage' is missing; add motor_voltage = {{ column = \"…\" }} (or {others}"
      ", whichever the drive takes; or steering_command alone, where somebody drove by hand) to [channels]. Columns "
      f"that exist: {table.listing()}"
    )
  if not resolved.keys() & {"motor_speed", "speed"} and not {"pose_x", "pose_y"} <= resolved.keys():
    raise RecordingError(
      f"{table.label}: neither 'motor_speed' nor 'speed' is there, nor a pose that gives it (pose_x, pose_y), and one "
      f"of them is needed; map it in [channels]. Columns that exist: {table.listing()}"
    )
  return resolved


def _refuse_near_miss(table: Table, column: str) -> None:
  absent = [channel for channel in CHANNELS if channel not in table]
  ending = nearest(column, absent, cutoff=0.8)
  if column not in CHANNELS and ending.startswith("; did"):
    raise UnknownChannelError(
      f"{table.label}: unknown channel '{column}'{ending} Rename the column, or write a [channels] table, "
      "after which other columns are ignored"
    )


def streams_of(table: Table, mapping: Mapping[str, Mapped]) -> tuple[dict[str, Stream], list[str]]:
  """Streams by channel from one file, and notes about what was assumed. `mapping` comes from `resolve`."""
  table, notes = in_time_order(table, mapping["time"])
  clock = _clock(table, mapping)
  values = {channel: _values(table, channel, mapped) for channel, mapped in mapping.items() if channel != "time"}
  values, gone = without_dropouts(values, {channel: mapped.offset for channel, mapped in mapping.items()}, table.label)
  publisher_rows = _publisher_rows({channel: value for channel, value in values.items() if mapping[channel].hold})
  streams, spread = {}, []
  for channel, value in values.items():
    there = np.flatnonzero(~np.isnan(value))
    if there.size == 0:
      _blank(table, channel, channel in (_drive(mapping), "motor_speed", "speed"), notes)
      continue
    if clock.repeats and _changes_inside(value, clock.first):
      time = clock.row_time
      spread.append(channel)
    else:
      time, there = clock.stamp, np.intersect1d(there, np.flatnonzero(clock.first))
    if mapping[channel].hold and not clock.repeats:
      there = there[published_samples(value[there], publisher_rows[channel])]
    sampled = value[there]
    period = turn_of(sampled) if CHANNELS[channel].angle or mapping[channel].wrap else 0.0
    jumps = int(np.sum(np.abs(np.diff(sampled)) > 0.5 * period)) if period else 0
    unsaid = mapping[channel].wrap is None and jumps > 0
    if mapping[channel].wrap or unsaid:
      check_angle(table.label, channel, sampled, period)
      sampled = np.unwrap(sampled, period=period or np.pi * 2.0)
    if unsaid:
      often = "once" if jumps == 1 else f"{jumps} times"
      notes.append(
        f"{table.label}: {channel} jumps by more than half a turn ({often}) and is unwrapped; set "
        f"wrap = true on {channel} in [channels] if that is right, wrap = false to keep the jumps"
      )
    streams[channel] = Stream(time[there] - mapping[channel].late, sampled)
  notes += [*table.notes, *gone] + signs_said(table, {channel: mapped.column for channel, mapped in mapping.items()})
  if spread:
    notes.append(
      f"{table.label}: time repeats because a slower publisher holds it; {', '.join(spread)} change in between "
      "and are spread evenly between its stamps"
    )
  return streams, notes


def _drive(mapping: Mapping[str, Mapped]) -> str | None:
  """What commands the drive in these files: the first of them where a log has several."""
  return next((channel for channel in DRIVE_COMMANDS if channel in mapping), None)


def _blank(table: Table, channel: str, needed: bool, notes: list[str]) -> None:
  if needed:
    raise RecordingError(
      f"{table.label}: needed channel '{channel}' has no sample, every cell is blank; map another column or remove "
      "this recording"
    )
  notes.append(f"{table.label}: {channel} has no sample, every cell is blank; the channel is left out")


def _values(table: Table, channel: str, mapped: Mapped) -> np.ndarray:
  raw = table.number(mapped.column, channel)
  value = mapped.scale * raw + mapped.offset if (mapped.scale, mapped.offset) != (1.0, 0.0) else raw
  _refuse_bad_values(table, channel, mapped.column, value)
  if mapped.gate is None:
    return value
  gate = table.number(mapped.gate, f"the gate of {channel}")
  there = np.flatnonzero(~np.isnan(gate))
  if there.size == 0:
    raise RecordingError(
      f"{table.label}: gate column '{mapped.gate}' of {channel} is blank in every row; remove the gate or log it"
    )
  return value * gate[there[np.maximum(np.searchsorted(there, np.arange(gate.size), side="right") - 1, 0)]]


def _refuse_bad_values(table: Table, channel: str, column: str, raw: np.ndarray) -> None:
  infinite = np.flatnonzero(np.isinf(raw))
  bad, what = infinite, "infinite"
  if CHANNELS[channel].is_command and not infinite.size:
    nans = table.not_a_number.get(column, NO_ROWS)
    bad, what = (nans if table.blanks or nans.size < _FEW_NANS * raw.size else NO_ROWS), "NaN"
  if bad.size:
    named = channel if channel == column else f"{channel} (column '{column}')"
    cure = "leave the cell blank where there is no sample, or cut those rows out"
    raise RecordingError(
      f"{table.label}: {named} is {what} in row {bad[0] + 1}"
      + (f" and {bad.size - 1} more" if bad.size > 1 else "")
      + f"; {cure}"
    )


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


def in_time_order(table: Table, mapped: Mapped) -> tuple[Table, list[str]]:
  """The rows by time, where `sort` says that some were written out of order, and a note how many."""
  if not mapped.sort:
    return table, []
  stamp = stamps(table, mapped)
  late = np.flatnonzero(np.diff(stamp) < 0.0) + 1
  if not late.size or not np.isfinite(stamp).all() or restarts(stamp):
    return table, []
  order = np.argsort(stamp, kind="stable")
  note = f"{table.label}: {late.size} of {table.rows} rows are out of order, first row {late[0] + 1}; sorted by time"
  return table.rows_in(order), [note]


def _clock(table: Table, mapping: Mapping[str, Mapped]) -> Clock:
  """Row times, after the checks. Repeated stamps pass where each channel has one value at most of a stamp, as where
  every message has a row of its own, or where the data set says that a publisher holds values."""
  stamp = stamps(table, mapping["time"])
  stamp = since_origin(stamp)
  columns = {channel: table.columns[mapped.column] for channel, mapped in mapping.items() if mapped.column in table}
  check_order(table.label, stamp, list(columns.values()))
  first = np.r_[True, np.diff(stamp) > 0.0]
  values = [column for channel, column in columns.items() if channel != "time"]
  if not first.all() and _complete_each_other(values, first):
    first = np.ones_like(first)
  if not first.all():
    _refuse_repeats(table, stamp, first, [other.column for other in mapping.values() if other.hold])
  check_time_unit(table.label, np.unique(stamp))
  check_span(table.label, stamp)
  return Clock(stamp, _row_times(stamp, first), first)


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
  changing = sum(bool((_changed(values) & ~first).any()) for values in read)
  if not repeated and changing > 1 and np.mean(~first) > _COARSE:  # rows of their own, and stamps of too few digits
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
    inside = np.flatnonzero(_changed(table.columns[column]) & ~first)
    if inside.size:
      raise RecordingError(
        f"{table.label}: time repeats in row {inside[0] + 1} ({stamp[inside[0]]:g} s again) although column "
        f"'{column}', which has hold = true, changes there; remove the repeated rows"
      )


def _changed(value: np.ndarray) -> np.ndarray:
  """Whether each row differs from the one before (a blank equals a blank); the first row counts as changed."""
  same = (value[1:] == value[:-1]) | (np.isnan(value[1:]) & np.isnan(value[:-1]))
  return np.r_[True, ~same]


def _changes_inside(value: np.ndarray, first: np.ndarray) -> bool:
  return bool((_changed(value) & ~first).any())


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


def published_samples(value: np.ndarray, usual: int) -> np.ndarray:
  """Indices of the samples behind values that a slower publisher repeats, (k,).

  A run of equal values is one sample; a run much longer than the publisher's `usual` number of rows is a true constant,
  published several times, and gives one sample per `usual` rows. `usual` 0 (unknown) keeps the changes and the last
  row.
  """
  start = np.flatnonzero(_changed(value))
  length = np.diff(np.r_[start, value.size])
  if usual == 0:
    return np.unique(np.r_[start, value.size - 1])
  repeats = np.maximum(np.round(length / usual).astype(int), 1)
  within = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
  return np.repeat(start, repeats) + (within * np.repeat(length / repeats, repeats)).astype(int)


def _publisher_rows(values: Mapping[str, np.ndarray]) -> dict[str, int]:
  """How many rows each repeated channel's publisher usually repeats a value: the lower quartile of its run lengths. A
  channel that changes seldom takes the smallest of those that change often, else its own; 0 when it never changes and
  nothing is known.
  """
  lengths = {}
  for channel, value in values.items():
    start = np.flatnonzero(_changed(value[~np.isnan(value)]))
    lengths[channel] = np.diff(start)[1:]  # neither the first run nor the last is whole
  usual = {
    channel: int(np.percentile(length, 25, method="lower")) for channel, length in lengths.items() if length.size
  }
  sure = [usual[channel] for channel, length in lengths.items() if length.size >= _MIN_RUNS]
  return {
    channel: usual[channel] if length.size >= _MIN_RUNS or (length.size and not sure) else min(sure, default=0)
    for channel, length in lengths.items()
  }
