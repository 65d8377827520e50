"""From the columns of a log to streams of channels: scale, offset, gate, repeated samples, unwrapped angles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from qcar_twin.recordings.channels import CHANNELS, DRIVE_COMMANDS
from qcar_twin.recordings.checks.driving import MOVING, runs
from qcar_twin.recordings.checks.dropouts import without_dropouts
from qcar_twin.recordings.checks.time import check_angle, turn_of
from qcar_twin.recordings.formats.table import NO_ROWS, Table
from qcar_twin.recordings.formats.unsigned import signs_said
from qcar_twin.recordings.manifest import Mapped
from qcar_twin.recordings.recording import RecordingError, Stream, UnknownChannelError, nearest
from qcar_twin.recordings.row_clock import changed, changes_inside, clock_of, in_time_order

_FEW_NANS = 0.05  # formats without blanks: rarer NaNs in a command are faults, commoner ones are an asynchronous stream
_CONSTANT = 1.5  # times the longest usual run: from there one that lasts is nearer to two publications than to one
_FINE, _LONGEST_SLOPE = 20.0, 0.1  # counts of a car that drives, and s, over which a speed is taken
_COUNTERS, _BEGUN = (16, 32), 0.25  # bits of counters, and share of their range that a car counts between two samples
_MIN_RUNS = 5  # runs of equal values that make a publisher's rate sure


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
    if mapped.column in table or mapped.column in table.withheld or channel in ("time", _drive(mapping)):
      resolved[channel] = mapped
  if "time" not in resolved:
    cure = 'add time = { column = "…" } to [channels], or time = { rate = … } in Hz where every row is one step'
    raise RecordingError(
      f"{table.label}: needed channel 'time' is missing; {cure}. Columns that exist: {table.listing()}"
    )
  if wanted := _wanted(set(resolved)):
    raise RecordingError(f"{table.label}: {'; and '.join(wanted)}. Columns that exist: {table.listing()}")
  return resolved


def _wanted(known: set[str]) -> list[str]:
  """What the channels of a file still lack, all at once, each with its cure."""
  moves = known & {"motor_speed", "speed"} or {"pose_x", "pose_y"} <= known
  wanted = []
  if not known & {*DRIVE_COMMANDS, "steering_command"}:
    others = ", ".join(DRIVE_COMMANDS[1:])
    wanted.append(
      f"needed channel 'motor_voltage' is missing; add motor_voltage = {{ column = \"…\" }} (or {others}, whichever "
      "the drive takes; or steering_command alone, where somebody drove by hand) to [channels]"
    )
  if not moves:
    wanted.append(
      "neither 'motor_speed' nor 'speed' is there, nor a pose that gives it (pose_x, pose_y), and one of them is "
      "needed; map it in [channels]"
    )
  if not moves and not known & set(DRIVE_COMMANDS) and "steering_command" in known:
    wanted.append(
      f"no column is mapped to a command of the drive ({', '.join(DRIVE_COMMANDS)}); map it, too, unless somebody "
      "drove by hand"
    )
  return wanted


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
  table, notes = in_time_order(table, mapping)
  clock, again = clock_of(table, mapping)
  values = {channel: _values(table, channel, mapped) for channel, mapped in mapping.items() if channel != "time"}
  values = _with_signs(table, mapping, values)
  values, gone = without_dropouts(values, {channel: mapped.offset for channel, mapped in mapping.items()}, table.label)
  publisher_rows = _publisher_rows({channel: value for channel, value in values.items() if mapping[channel].hold})
  streams, spread = {}, []
  for channel, value in values.items():
    there = np.flatnonzero(~np.isnan(value))
    if there.size == 0:
      _blank(table, channel, channel in (_drive(mapping), "motor_speed", "speed"), notes)
      continue
    if clock.held and changes_inside(value, clock.first):
      time = clock.row_time
      spread.append(channel)
    else:
      time, there = clock.stamp, there[clock.first[there]]
    if mapping[channel].hold and not clock.held:
      there = there[published_samples(value[there], *publisher_rows[channel])]
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
    stamp = time[there] - mapping[channel].late
    slope = mapping[channel].slope
    streams[channel] = slope_of(stamp, sampled, abs(mapping[channel].scale)) if slope else Stream(stamp, sampled)
  notes += [*table.notes, *again, *gone] + signs_said(
    table, {channel: mapped.column for channel, mapped in mapping.items()}
  )
  if spread:
    notes.append(
      f"{table.label}: time repeats because a slower publisher holds it; {', '.join(spread)} change in between "
      "and are spread evenly between its stamps"
    )
  return _at_centre(streams, mapping, table.label), notes


def slope_of(time: np.ndarray, value: np.ndarray, count: float) -> Stream:
  """What adds up, (k,), as its change per second: over so many samples that a count more or less is a twentieth of
  what a car that drives counts in them, and over 0.1 s at most; in the middle of those.

  Args:
    time: s.  value: an encoder's counts times `count`, the unit of one; counters of 16 and 32 bits begin anew.
  """
  step = np.diff(value)
  for bits in _COUNTERS:
    begun = np.abs(np.abs(step) / count - 2.0**bits) < _BEGUN * 2.0**bits
    step = np.where(begun, step - np.sign(step) * count * 2.0**bits, step)
  whole = np.r_[value[:1], value[0] + np.cumsum(step)]
  usual = float(np.median(np.abs(step[step != 0.0]))) if step.any() else count
  longest = int(_LONGEST_SLOPE / max(float(np.median(np.diff(time))), 1e-9)) if time.size > 1 else 1
  over = int(np.clip(np.ceil(_FINE * count / usual), 1, max(longest, 1)))
  ends = np.arange(0, time.size, over)
  passed = np.diff(time[ends])
  there = passed > 0.0
  middle = 0.5 * (time[ends[1:]] + time[ends[:-1]])
  return Stream(middle[there], np.diff(whole[ends])[there] / passed[there])


def _at_centre(streams: dict[str, Stream], mapping: Mapping[str, Mapped], label: str) -> dict[str, Stream]:
  """The place of the centre of gravity, from that of the point `ahead` and to the `left` of it which was logged."""
  ahead, left = (getattr(mapping.get(channel), key, 0.0) for channel, key in (("pose_x", "ahead"), ("pose_y", "left")))
  if (ahead, left) == (0.0, 0.0) or not {"pose_x", "pose_y"} & streams.keys():
    return streams
  if not {"pose_x", "pose_y", "pose_yaw"} <= streams.keys():
    raise RecordingError(
      f"{label}: the place is that of a point {ahead:g} m ahead and {left:g} m left of the centre of gravity, as ahead "
      "and left on pose_x and pose_y say; to find the centre pose_x, pose_y and pose_yaw are needed: map all three"
    )
  moved = {}
  for channel, along, across in (("pose_x", ahead, -left), ("pose_y", left, ahead)):
    place = streams[channel]
    yaw = np.interp(place.time, streams["pose_yaw"].time, streams["pose_yaw"].value)
    shift = along * np.cos(yaw) + across * np.sin(yaw)
    moved[channel] = Stream(place.time, place.value - shift)
  return streams | moved


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
  if mapped.minus is not None:
    raw = raw - _held(table, mapped.minus, "minus", channel)
  value = mapped.scale * raw + mapped.offset if (mapped.scale, mapped.offset) != (1.0, 0.0) else raw
  _refuse_bad_values(table, channel, mapped.column, value)
  if mapped.gate is None:
    return value
  return value * _held(table, mapped.gate, "gate", channel)


def _held(table: Table, column: str, role: str, channel: str) -> np.ndarray:
  """A column that acts on another, (rows,): in each row the last value that was logged, before the first that one."""
  values = table.number(column, f"the {role} of {channel}")
  there = np.flatnonzero(~np.isnan(values))
  if there.size == 0:
    raise RecordingError(
      f"{table.label}: {role} column '{column}' of {channel} is blank in every row; remove the {role} or log it"
    )
  return values[there[np.maximum(np.searchsorted(there, np.arange(values.size), side="right") - 1, 0)]]


def _with_signs(table: Table, mapping: Mapping[str, Mapped], values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
  """The channels with the sign of another one where [channels] says so, as `signed_by = "motor_voltage"`."""
  whole = dict(values)
  for channel, mapped in mapping.items():
    if mapped.signed_by is None or channel == "time":
      continue
    if mapped.signed_by not in values or mapped.signed_by == channel:
      others = ", ".join(name for name in values if name != channel)
      raise RecordingError(
        f"{table.label}: {channel} has signed_by = '{mapped.signed_by}', which is no other channel of this file; name"
        f" one of {others}"
      )
    whole[channel] = signed_by(values[channel], values[mapped.signed_by])
  return whole


def signed_by(size: np.ndarray, other: np.ndarray) -> np.ndarray:
  """A speed's size, (k,), with the sign that the other channel's sum has while the car moves on.

  A car turns round only at rest, so that a command that brakes it does not turn it. NaN where there is no sample.
  """
  there = np.flatnonzero(np.isfinite(size))
  speed, known = np.abs(size[there]), np.flatnonzero(np.isfinite(other))
  if not there.size or not known.size:
    return size
  way = np.interp(there, known, other[known])
  drives = [r for r in runs(speed > MOVING * float(np.percentile(speed, 99.0))) if r[2]]
  signs, done, before = np.ones(there.size), 0, 0.0
  for first, last, _ in drives:
    sign = -1.0 if way[first : last + 1].sum() < 0.0 else 1.0
    turns = done + int(np.argmin(speed[done : first + 1])) if before else 0  # between two drives, where it is slowest
    signs[done:turns], signs[turns : last + 1] = before, sign
    done, before = last + 1, sign
  signs[done:] = before or 1.0
  whole = size.copy()
  whole[there] = signs * speed
  return whole


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


def published_samples(value: np.ndarray, usual: int, longest: int | None = None) -> np.ndarray:
  """Indices of the samples behind values that a slower publisher repeats, (k,).

  A run of equal values is one sample; a run that is half as long again as the publisher's `longest` usual number of
  rows is a true constant, published several times, and gives one sample per `usual` rows. `usual` 0 (unknown) keeps the
  changes and the last row. `longest`: `usual` where it is not given, of a publisher that keeps its rate.
  """
  start = np.flatnonzero(changed(value))
  length = np.diff(np.r_[start, value.size])
  if usual == 0:
    return np.unique(np.r_[start, value.size - 1])
  constant = length >= _CONSTANT * max(usual, longest or 0)
  repeats = np.where(constant, np.maximum(np.round(length / usual), 1), 1).astype(int)
  within = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
  return np.repeat(start, repeats) + (within * np.repeat(length / repeats, repeats)).astype(int)


def _publisher_rows(values: Mapping[str, np.ndarray]) -> dict[str, tuple[int, int]]:
  """How many rows each repeated channel's publisher usually repeats a value, at least and at most: the quartiles of its
  run lengths. A channel that changes seldom takes those of the fastest that changes often, else its own; 0 when it
  never changes and nothing is known.
  """
  lengths = {}
  for channel, value in values.items():
    start = np.flatnonzero(changed(value[~np.isnan(value)]))
    lengths[channel] = np.diff(start)[1:]  # neither the first run nor the last is whole
  usual = {}
  for channel, length in lengths.items():
    if length.size:
      least, most = np.percentile(length, [25, 75], method="lower")
      usual[channel] = (int(least), int(most))
  sure = [usual[channel] for channel, length in lengths.items() if length.size >= _MIN_RUNS]
  return {
    channel: usual[channel] if length.size >= _MIN_RUNS or (length.size and not sure) else min(sure, default=(0, 0))
    for channel, length in lengths.items()
  }
