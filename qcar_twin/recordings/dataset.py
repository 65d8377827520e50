"""A data set: a folder with one dataset.toml and any number of recording files."""

from __future__ import annotations

import dataclasses
import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.checks.clock_unit import check_clock_unit
from qcar_twin.recordings.checks.driving import gaps
from qcar_twin.recordings.checks.faults import (
  after_start,
  find_defects,
  outside,
  without_clipped,
  without_lost,
  without_stuck,
)
from qcar_twin.recordings.checks.jumps import Jump, refuse_changed_units, without_jumps
from qcar_twin.recordings.checks.pushes import without_lifted
from qcar_twin.recordings.checks.repeats import refuse_repeats
from qcar_twin.recordings.checks.steered import without_dead_steering, without_unsteered
from qcar_twin.recordings.checks.supply import supply_notes
from qcar_twin.recordings.checks.time import MIN_SAMPLES
from qcar_twin.recordings.checks.units import check_limits, check_units, check_way, without_spikes
from qcar_twin.recordings.completed import completed
from qcar_twin.recordings.formats import Table, read_inside
from qcar_twin.recordings.manifest import FILE_NAME, Entry, Manifest, Mapped, read_manifest
from qcar_twin.recordings.mapping import resolve, streams_of
from qcar_twin.recordings.notices import gathered
from qcar_twin.recordings.origin import near
from qcar_twin.recordings.recording import ROLES, Recording, RecordingError, UnitError, nearest
from qcar_twin.recordings.row_clock import origin_of, stamps
from qcar_twin.recordings.topic_maps import topic_map
from qcar_twin.recordings.unit_names import unit_of

_log = logging.getLogger(__name__)
_PERIOD = 0.01  # s, on which commands are added up


@dataclass(frozen=True, eq=False)
class DataSet:
  """Recordings of one car in the order they were driven, what was measured of the car, and warnings.

  Each recording knows what was driven before it, whatever roles and sessions lie between.
  """

  name: str
  recordings: tuple[Recording, ...]
  vehicle: Mapping[str, float | str] = field(default_factory=dict)
  vehicle_std: Mapping[str, float] = field(default_factory=dict)
  description: str = ""
  command_timing: str = "after_measurement"
  licence: str = ""
  source: str = ""
  warnings: tuple[str, ...] = ()

  def __post_init__(self) -> None:
    object.__setattr__(self, "recordings", in_order(self.recordings))

  @classmethod
  def load(cls, folder: str | os.PathLike[str]) -> DataSet:
    """Read folder/dataset.toml and what it lists. Raises RecordingError naming file, channel, row and cure."""
    folder = Path(folder)
    manifest = read_manifest(folder)
    tables = [read_inside(folder, entry.file).named(manifest.columns) for entry in manifest.entries]
    warnings = list(manifest.notes) + _absent_columns(manifest, tables)
    recordings: list[Recording] = []
    files = list(zip(manifest.entries, tables, strict=True))
    for entry, table in files:
      try:
        made, notes = _recordings(manifest, entry, table)
      except UnitError as error:
        if alone := _alone(manifest, [file for file in files if file[0].file != entry.file]):
          raise RecordingError(f"{error.said}{alone}") from error
        raise
      recordings += made
      warnings += notes
    recordings, lifted = without_lifted(recordings, manifest.vehicle)
    recordings, dead = without_dead_steering(recordings, manifest.vehicle)
    recordings, unsteered = without_unsteered(recordings)
    warnings += lifted + dead + unsteered + refuse_repeats(recordings) + supply_notes(recordings, manifest.vehicle)
    for notice in gathered(warnings):
      _log.warning(notice)
    return cls(
      manifest.name,
      tuple(near(recordings)),
      manifest.vehicle,
      manifest.vehicle_std,
      manifest.description,
      manifest.command_timing,
      manifest.licence,
      manifest.source,
      tuple(warnings),
    )

  @property
  def notices(self) -> tuple[str, ...]:
    """The warnings, one for all that differ in nothing but a file's name and numbers."""
    return gathered(self.warnings)

  def role(self, role: str) -> tuple[Recording, ...]:
    """The recordings with this role: identify, validate or holdout."""
    if role not in ROLES:
      raise RecordingError(f"unknown role '{role}'{nearest(role, ROLES)}")
    return tuple(recording for recording in self.recordings if recording.role == role)

  def __getitem__(self, name: str) -> Recording:
    """The recording of this name; RecordingError names the nearest one."""
    for recording in self.recordings:
      if recording.name == name:
        return recording
    raise RecordingError(
      f"data set '{self.name}' has no recording '{name}'{nearest(name, [r.name for r in self.recordings])}"
    )


def in_order(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
  """The same recordings, each with the seconds driven and V^2 s spent before it, V the drive's command; one that knows
  them keeps them."""
  out: list[Recording] = []
  seconds, energy = 0.0, 0.0
  for recording in recordings:
    seconds, energy = recording.before or (seconds, energy)
    out.append(recording.replace(before=(seconds, energy)))
    _, commands = recording.commands(_PERIOD, (recording.drive_channel,))
    seconds += len(commands) * _PERIOD
    energy += float(np.sum(commands**2)) * _PERIOD
  return tuple(out)


def _absent_columns(manifest: Manifest, tables: list[Table]) -> list[str]:
  """A mapped column that no file has is an error; one that some files lack is worth a line."""
  notes = []
  for channel, mapped in manifest.mapping.items():
    if mapped.rate is not None:
      continue
    without = [table for table in tables if mapped.column not in table]
    if len(without) == len(tables):
      tables[0].number(mapped.column, channel)
    if without:
      notes.append(
        f"{channel}: column '{mapped.column}' is absent in {len(without)} of {len(tables)} files "
        f"({without[0].label}, …)"
      )
  return notes


def _recordings(manifest: Manifest, entry: Entry, table: Table) -> tuple[list[Recording], list[str]]:
  mapping = resolve(table, _mapping(manifest, table))
  streams, notes = streams_of(table, mapping)
  origin = (origin_of(stamps(table, mapping["time"])), 0.0, 0.0)
  whole = Recording(entry.name, streams, entry.file, entry.role, entry.manoeuvre, entry.session, origin=origin)
  check_limits(whole, manifest.vehicle, _said(mapping))
  if (entry.begin, entry.end) != (-np.inf, np.inf):
    whole = _part(whole, entry)
  whole, spikes = without_spikes(whole, manifest.vehicle)
  whole, lost, left_out = without_lost(whole)
  whole, jumps, flickers = without_jumps(whole, _length(manifest.vehicle))
  whole, stuck, gone, said = without_stuck(whole)
  whole, beyond, clipped = without_clipped(whole)
  notes += [*spikes, *left_out, *flickers, *said, *clipped]
  pieces, cuts = _cut(whole, jumps, stuck)
  refuse_changed_units(whole)
  signs = check_units(whole, manifest.vehicle)
  check_clock_unit(whole)
  pieces, said = completed(pieces, manifest.vehicle, table.label)
  for piece in pieces:
    check_way(piece, manifest.vehicle)
  notes += said
  return pieces, [
    *notes,
    *signs,
    *cuts,
    *(defect for piece in pieces for defect in find_defects(piece, [*lost, *gone, *beyond])),
  ]


def _alone(manifest: Manifest, others: Sequence[tuple[Entry, Table]]) -> str:
  """What a file in another unit than most of the others needs, since [channels] holds for all; "" where it is not."""
  right = 0
  for entry, table in others:
    try:
      _recordings(manifest, entry, table)
      right += 1
    except UnitError:
      pass
    except RecordingError:
      return ""
  if 2 * right <= len(others):
    return ""
  return f", and {right} of the other {len(others)} files agree: correct this file's column, or leave the file out"


def _mapping(manifest: Manifest, table: Table) -> dict[str, Mapped]:
  """What the ready-made map says of this file, if there is one, and over it what dataset.toml itself says."""
  if not manifest.topics:
    return manifest.mapping
  return topic_map(manifest.topics).mapping(table.columns, table.label, manifest.mapping) | manifest.mapping


def _said(mapping: Mapping[str, Mapped]) -> set[str]:
  """The channels whose columns name the unit that they are read in."""
  units = {channel: unit_of(mapped.column) for channel, mapped in mapping.items()}
  return {c for c, unit in units.items() if unit and unit[1:] == (CHANNELS[c].unit, mapping[c].scale)}


def _part(whole: Recording, entry: Entry) -> Recording:
  """What lies between from and to, s on the file's clock, or from its start where that clock is a date's."""
  dated = whole.origin[0]
  if dated:
    since = lambda time: time - dated if abs(time - dated) < abs(time) < np.inf else time  # nearer to it than to 0
    entry = dataclasses.replace(entry, begin=since(entry.begin), end=since(entry.end))
  if entry.begin >= whole.end or entry.end <= whole.start:
    raise RecordingError(
      f"{entry.file}: recording '{entry.name}' is to be a part {_span(entry)}, where the file has nothing: its "
      f"time runs from {whole.start:g} s to {whole.end:g} s; correct from and to in {FILE_NAME}"
    )
  return whole.window(max(entry.begin, whole.start), min(entry.end, whole.end))


def _span(entry: Entry) -> str:
  return " ".join(f"{word} {at:g} s" for word, at in (("from", entry.begin), ("to", entry.end)) if np.isfinite(at))


def _length(vehicle: Mapping[str, float | str]) -> float:
  """The car's wheelbase, m; a 1:10 car's where it is not given."""
  return float(vehicle.get("cg_to_front", 0.128)) + float(vehicle.get("cg_to_rear", 0.128))


def _cut(
  whole: Recording, jumps: Sequence[Jump] = (), out: Sequence[tuple[float, float]] = ()
) -> tuple[list[Recording], list[str]]:
  """Cut where nothing was logged for long and where the pose jumps, without spans that are left out, s; pieces too
  short to use are dropped."""
  time, after = gaps(whole)
  cuts = np.union1d(after, np.searchsorted(time, [jump.after for jump in jumps]).astype(int))
  spans = outside([(rows[0], rows[-1]) for rows in np.split(time, cuts)], out)
  counts = [_samples(whole, *span) for span in spans]
  notes = [
    f"{whole.file}: nothing was logged from {time[row - 1]:g} s to {time[row]:g} s{after_start(whole)}; the recording "
    "is cut there"
    for row in after
  ]
  notes += [
    f"{whole.file}: the pose jumps by {jump.distance:.3g} m in {1e3 * (jump.after - jump.before):.0f} ms at "
    f"{jump.after:g} s{after_start(whole)}; the recording is cut there"
    for jump in jumps
  ]
  if (most := max(counts, default=0)) < MIN_SAMPLES:
    raise RecordingError(
      f"{whole.file}: too few samples ({most}); at least {MIN_SAMPLES} without a gap are needed; remove this recording"
    )
  notes += [
    f"{whole.file}: the piece from {span[0]:g} s to {span[1]:g} s has too few samples ({count}) and is left out"
    for span, count in zip(spans, counts, strict=True)
    if count < MIN_SAMPLES
  ]
  pieces = [whole.window(*span) for span, count in zip(spans, counts, strict=True) if count >= MIN_SAMPLES]
  if len(pieces) > 1:
    pieces = [piece.replace(name=f"{whole.name}#{number}") for number, piece in enumerate(pieces, 1)]
  return pieces, notes


def _samples(recording: Recording, start: float, end: float) -> int:
  """Samples of the vehicle's speed, or of the pose that gives it, in a span: what every use of a recording needs."""
  time = recording[next(name for name in ("motor_speed", "speed", "pose_x") if name in recording)].time
  return int(((time >= start) & (time <= end)).sum())
