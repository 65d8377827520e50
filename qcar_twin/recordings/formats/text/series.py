"""Series of a database as columns: points by measurement and tags, which tell drives, sensors or nothing."""

from __future__ import annotations

import dataclasses
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from qcar_twin.recordings.formats.table import Clocked, SeveralRecordings, Table, merge
from qcar_twin.recordings.recording import RecordingError

Stamps = NDArray[np.int64]
_MOST = 200  # drives of a file, and tags and sensors of a measurement
_WIDEST = 10_000  # fields of a file
_STATE = 10  # samples in a row with one value of a tag that tells a state: several sensors take turns
_MANY = 0.5  # of the points, which have a tag that tells drives


@dataclass
class Series:
  """A measurement with its tags; by field the stamps as they were written, and the values. `stem` is what the columns'
  names begin with, the measurement and its sensor."""

  measurement: str
  tags: Mapping[str, str]
  fields: dict[str, tuple[array[int], array[float]]] = field(default_factory=dict)
  texts: set[str] = field(default_factory=set)
  stem: str = ""

  def add(self, name: str, stamp: int, value: float | None) -> None:
    """One value of a field; None for a text."""
    if value is None:
      self.texts.add(name)
      return
    if name not in self.fields:
      self.fields[name] = (array("q"), array("d"))
    stamps, values = self.fields[name]
    stamps.append(stamp)
    values.append(value)

  def stamps(self) -> Stamps:
    """When it has points with numbers, each stamp once, in order."""
    written = [np.array(stamps, dtype=np.int64) for stamps, _ in self.fields.values()]
    return np.unique(np.concatenate(written)) if written else np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class _Drive:
  """A value of the tag that tells drives, and its first and last stamp; the one drive of a file without such a tag."""

  tag: str
  value: str
  first: int
  last: int


def table_of(series: Sequence[Series], scale: float, label: str, notes: Sequence[str] = ()) -> Table:
  """The columns of all series, `measurement.field`, each on its own stamps, in s by `scale`.

  A tag whose values follow one another tells drives; one whose values take turns tells sensors, whose names it goes
  into, `imu_front.acc_x`. Other tags are dropped.

  Raises:
    SeveralRecordings: there are several drives.
    RecordingError: more drives or sensors than a file has.
  """
  notes = list(notes)
  if texts := sorted({f"{one.measurement}.{name}" for one in series for name in one.texts}):
    more = f" and {len(texts) - 1} more" if len(texts) > 1 else ""
    notes.append(f"{label}: '{texts[0]}'{more} holds texts; left out")
  full = [one for one in series if one.fields]
  if (count := len({(one.measurement, name) for one in full for name in one.fields})) > _WIDEST:
    raise RecordingError(
      f"{label}: has {count} fields, and a log has at most {_WIDEST}; write the time as a stamp, not as a field's name"
    )
  drives = _drives(full, label)
  _name(full, drives[0].tag if drives else "", label, notes)
  if not drives:
    return _with(merge(label, _groups(full, scale, None)), notes)
  tag = drives[0].tag
  if outside := sum(_outside(one, drives) for one in full if tag not in one.tags):
    notes.append(f"{label}: {outside} points without the tag '{tag}' are of no time of a drive; left out")
  tables = {}
  for drive in drives:
    name = f"{tag}_{drive.value}" if drive.value.isdigit() else drive.value
    own = [one for one in full if one.tags.get(tag, drive.value) == drive.value]
    tables[name] = _with(merge(f"{label}/{name}", _groups(own, scale, drive)), notes if not tables else ())
  raise SeveralRecordings(label, tables)


def _with(table: Table, notes: Sequence[str]) -> Table:
  return dataclasses.replace(table, notes=(*notes, *table.notes))


def _drives(series: Sequence[Series], label: str) -> list[_Drive]:
  """In order the values of the tag that most points have, and whose values follow one another in time; of several such
  tags of the one with the most values. None where there is no such tag."""
  spans: dict[str, dict[str, tuple[int, int]]] = {}
  counts: dict[str, int] = {}
  total = 0
  for one in series:
    stamps = one.stamps()
    total += stamps.size
    for tag, value in one.tags.items():
      own = spans.setdefault(tag, {})
      first, last = own.get(value, (int(stamps[0]), int(stamps[-1])))
      own[value] = (min(first, int(stamps[0])), max(last, int(stamps[-1])))
      counts[tag] = counts.get(tag, 0) + stamps.size
  best: list[_Drive] = []
  for tag, values in spans.items():
    drives = sorted((_Drive(tag, value, *span) for value, span in values.items()), key=lambda each: each.first)
    apart = all(one.last < other.first for one, other in zip(drives, drives[1:], strict=False))
    if len(drives) > max(1, len(best)) and apart and counts[tag] > _MANY * total:
      best = drives
  if len(best) > _MOST:
    raise RecordingError(
      f"{label}: tag '{best[0].tag}' has {len(best)} values, one after another, and a file has at most {_MOST} drives;"
      " export it without that tag, or fewer drives"
    )
  return best


def _name(series: Sequence[Series], drive: str, label: str, notes: list[str]) -> None:
  """Say of each series what its columns begin with: the measurement, and the sensor where tags tell several."""
  by_measurement: dict[str, list[Series]] = {}
  for one in series:
    by_measurement.setdefault(one.measurement, []).append(one)
  sensors: dict[str, tuple[str, ...]] = {}
  for measurement, own in by_measurement.items():
    tags = _sensor_tags(own, drive, label, notes)
    for one in own:
      told = (measurement, *_told(one, tags))
      one.stem = "_".join(filter(None, told))
      if sensors.setdefault(one.stem, told) != told:
        raise RecordingError(f"{label}: both a measurement and a sensor are '{one.stem}'; rename one of them")


def _sensor_tags(series: Sequence[Series], drive: str, label: str, notes: list[str]) -> list[str]:
  """The tags of a measurement that tell its sensors; a note on those that tell a state."""
  tags: list[str] = []
  named = dict.fromkeys(tag for one in series for tag in one.tags if tag != drive)
  if len(named) > _MOST:
    raise RecordingError(f"{label}: '{series[0].measurement}' has {len(named)} tags; export it with at most {_MOST}")
  for tag in named:
    if len({_told(one, [*tags, tag]) for one in series}) == len({_told(one, tags) for one in series}):
      continue
    if not _take_turns(series, tag):
      notes.append(f"{label}: tag '{tag}' of '{series[0].measurement}' changes in mid-file; its values share columns")
      continue
    tags.append(tag)
    if (count := len({_told(one, tags) for one in series})) > _MOST:
      raise RecordingError(
        f"{label}: tag '{tag}' of '{series[0].measurement}' tells {count} sensors, and a car has at most {_MOST};"
        " export it without that tag"
      )
  return tags


def _told(series: Series, tags: Sequence[str]) -> tuple[str, ...]:
  return tuple(series.tags.get(tag, "") for tag in tags)


def _take_turns(series: Sequence[Series], tag: str) -> bool:
  """Whether the values of a tag alternate in time, as those of several sensors do; a state's come in long runs."""
  stamps = [one.stamps() for one in series]
  values = {value: k for k, value in enumerate(dict.fromkeys(one.tags.get(tag, "") for one in series))}
  codes = np.repeat([values[one.tags.get(tag, "")] for one in series], [each.size for each in stamps])
  codes = codes[np.argsort(np.concatenate(stamps), kind="stable")]
  begins = np.flatnonzero(np.diff(codes, prepend=-1))
  runs = np.bincount(codes[begins], minlength=len(values))
  return bool((np.bincount(codes, minlength=len(values)) < _STATE * runs).any())


def _groups(series: Sequence[Series], scale: float, drive: _Drive | None) -> list[Clocked]:
  """The columns of a drive, those of one sensor that have the same stamps together. A point that was written twice is
  one."""
  parts: dict[tuple[str, str], list[tuple[Stamps, NDArray[np.float64]]]] = {}
  for one in series:
    for name, (written, numbers) in one.fields.items():
      stamps, values = np.array(written, dtype=np.int64), np.array(numbers)
      if drive is not None and drive.tag not in one.tags:
        inside = (stamps >= drive.first) & (stamps <= drive.last)
        stamps, values = stamps[inside], values[inside]
      if stamps.size:
        parts.setdefault((one.stem, name), []).append((stamps, values))
  groups: list[tuple[str, Stamps, dict[str, NDArray[np.float64]]]] = []
  for (stem, name), pieces in parts.items():
    stamps, values = (np.concatenate(each) for each in zip(*pieces, strict=True))
    order = np.argsort(stamps, kind="stable")
    stamps, values = stamps[order], values[order]
    once = np.append(True, (np.diff(stamps) != 0) | (np.diff(values) != 0.0))
    stamps, values = stamps[once], values[once]
    if groups and groups[-1][0] == stem and np.array_equal(groups[-1][1], stamps):
      groups[-1][2][f"{stem}.{name}"] = values
    else:
      groups.append((stem, stamps, {f"{stem}.{name}": values}))
  return [Clocked(scale * stamps, columns) for _, stamps, columns in groups]


def _outside(series: Series, drives: Sequence[_Drive]) -> int:
  """Stamps of a series that are of no drive's time."""
  stamps = series.stamps()
  return stamps.size - sum(int(((stamps >= each.first) & (stamps <= each.last)).sum()) for each in drives)
