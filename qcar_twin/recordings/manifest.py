"""dataset.toml: what a person wrote about a data set, parsed and checked before any recording is opened."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.checks.car import SIZES, check_car, check_deviations
from qcar_twin.recordings.recording import ROLES, RecordingError, UnknownChannelError, nearest
from qcar_twin.untrusted import UnreadableFile, inside, is_number, read_toml

FILE_NAME = "dataset.toml"
COMMAND_TIMINGS = ("after_measurement", "unknown")
_ENTRY = ("file", "role", "name", "manoeuvre", "session", "from", "to")
_TOP = ("name", "command_timing", "description", "licence", "source", "map", "columns", "undecided", "vehicle",
        "channels", "recording")  # fmt: skip


@dataclass(frozen=True)
class Mapped:
  """How one log column becomes a channel: value = (scale * (column - minus column) + offset) * gate column.

  `wrap`: an angle that jumps by turns is unwrapped; None where nobody said: it is, with a note.
  `late`: s by which the log has the channel later than it was. `signed_by`: the channel that has the sign it lacks.
  `slope`: the column adds up, as an encoder's counts or an odometer's metres: a speed is what it changes by per second.
  Of the clock alone: `rate` [Hz] of a log without one, whose rows are 1 / rate apart; `steps`: each row has the time
  since the row before; `sort`: rows that were written out of order are sorted by time. Of the pose alone: `ahead` (on
  pose_x) and `left` (on pose_y), m from the centre of gravity to the point whose place the log has.
  """

  column: str
  scale: float = 1.0
  offset: float = 0.0
  wrap: bool | None = None
  hold: bool = False
  gate: str | None = None
  signed_by: str | None = None
  late: float = 0.0
  rate: float | None = None
  steps: bool = False
  sort: bool = False
  ahead: float = 0.0
  left: float = 0.0
  slope: bool = False
  minus: str | None = None


@dataclass(frozen=True)
class Entry:
  """One [[recording]] table; `begin` and `end`, s on the file's own clock, where only a part of the file is meant."""

  file: str
  role: str
  name: str
  manoeuvre: str = "unspecified"
  session: str | None = None
  begin: float = -math.inf
  end: float = math.inf


@dataclass(frozen=True)
class Manifest:
  """The checked content of a dataset.toml. `notes` are warnings about it, `topics` the map of its key `map`,
  `columns` the names of the columns of files without a header."""

  name: str
  entries: tuple[Entry, ...]
  vehicle: dict[str, float | str]
  vehicle_std: dict[str, float]
  mapping: dict[str, Mapped]
  command_timing: str = "after_measurement"
  description: str = ""
  licence: str = ""
  source: str = ""
  notes: tuple[str, ...] = field(default=())
  topics: str = ""
  columns: tuple[str, ...] = ()


def read_manifest(folder: Path) -> Manifest:
  """Read folder/dataset.toml. Raises RecordingError naming the key, what is wrong with it, and the cure."""
  raw = _read_toml(folder)
  notes = _unknown_keys(raw)
  _refuse_undecided(raw)
  timing = _text(raw, "command_timing", "", COMMAND_TIMINGS[0])
  if timing not in COMMAND_TIMINGS:
    raise RecordingError(f"{FILE_NAME}: unknown command_timing '{timing}'{nearest(timing, COMMAND_TIMINGS)}")
  vehicle, std = _vehicle(_table(raw, "vehicle", ""))
  missing = [key for key in SIZES if key not in vehicle]
  if missing:
    notes.append(
      f"{FILE_NAME}: [vehicle] gives no {', '.join(missing)}; measure them, or the nominal car's numbers stand in"
    )
  mapping = _mapping(_table(raw, "channels", ""))
  texts = {key: _text(raw, key, "", "") for key in ("description", "licence", "source")}
  name = _text(raw, "name", "", folder.resolve().name)
  topics = _text(raw, "map", "", "") if "map" in raw else ""
  return Manifest(
    name,
    _entries(raw),
    vehicle,
    std,
    mapping,
    timing,
    **texts,
    notes=tuple(notes),
    topics=topics,
    columns=_columns(raw),
  )


def _refuse_undecided(raw: Mapping[str, Any]) -> None:
  """A draft asks what it could not settle; nothing is read before a person has answered."""
  if questions := raw.get("undecided"):
    first = questions[0] if isinstance(questions, list) else questions
    raise RecordingError(
      f"{FILE_NAME}: not decided yet: {first}; correct [channels] by it, or leave it, and delete it from undecided"
    )


def _columns(raw: Mapping[str, Any]) -> tuple[str, ...]:
  names = raw.get("columns", [])
  if not isinstance(names, list) or not all(isinstance(name, str) and name.strip() for name in names):
    raise RecordingError(f'{FILE_NAME}: columns must list names, as in columns = ["time", "speed"], not {names!r:.60}')
  if len(set(names)) < len(names):
    raise RecordingError(f"{FILE_NAME}: columns names one column twice; give each a name of its own")
  return tuple(names)


def _read_toml(folder: Path) -> dict[str, Any]:
  path = folder / FILE_NAME
  if not folder.exists():
    raise RecordingError(f"{folder}: no such folder; give the folder that holds {FILE_NAME}")
  if not folder.is_dir():
    if folder.name == FILE_NAME:
      raise RecordingError(f"{folder}: is a file; give the folder that holds it, {folder.parent}")
    made = f"of a log, qcar-twin new FOLDER {folder.name} makes one"
    raise RecordingError(f"{folder}: is a file; give the folder that holds {FILE_NAME}; {made}")
  if not path.is_file():
    raise RecordingError(
      f"{folder}: holds no {FILE_NAME}; qcar-twin new {folder} drafts one of the logs in it, or write one with a "
      "[vehicle] table and a [[recording]] per file (see docs/reference/recordings.md)"
    )
  try:
    return read_toml(inside(folder, FILE_NAME))
  except UnreadableFile as error:
    raise RecordingError(str(error)) from error
  except OSError as error:
    raise RecordingError(f"{FILE_NAME}: cannot be read ({error}); check its permissions") from error


def _unknown_keys(raw: Mapping[str, Any]) -> list[str]:
  notes = []
  for key in raw:
    ending = nearest(key, _TOP, cutoff=0.75)
    if key not in _TOP and ending.startswith("; did"):
      raise RecordingError(f"{FILE_NAME}: unknown key '{key}'{ending}")
    if key not in _TOP:
      notes.append(f"{FILE_NAME}: key '{key}' is not used")
  return notes


def _table(raw: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
  value = raw.get(key, {})
  if not isinstance(value, dict):
    raise RecordingError(f"{FILE_NAME}: {where}{key} must be a table [{key}], not {value!r}")
  return value


def _text(raw: Mapping[str, Any], key: str, where: str, default: str) -> str:
  value = raw.get(key, default)
  if not isinstance(value, str) or (key in ("name", "file", "column", "gate", "map") and not value.strip()):
    raise RecordingError(f'{FILE_NAME}: {where}{key} must be text such as "{key}_1", not {value!r}')
  return value


def _number(raw: Mapping[str, Any], key: str, where: str, default: float = 0.0) -> float:
  value = raw.get(key, default)
  if not is_number(value):
    raise RecordingError(f"{FILE_NAME}: {where}{key} must be a finite number, not {value!r:.60}")
  return float(value)


def _flag(raw: Mapping[str, Any], key: str, where: str) -> bool:
  value = raw.get(key, False)
  if not isinstance(value, bool):
    raise RecordingError(f"{FILE_NAME}: {where}{key} must be true or false, not {value!r}")
  return value


def _vehicle(raw: Mapping[str, Any]) -> tuple[dict[str, float | str], dict[str, float]]:
  vehicle: dict[str, float | str] = {}
  for key, value in raw.items():
    if key == "std":
      continue
    ending = nearest(key, [known for known in SIZES if known not in raw], cutoff=0.8)
    if key not in SIZES and ending.startswith("; did"):
      raise RecordingError(f"{FILE_NAME}: [vehicle] has unknown key '{key}'{ending}")
    vehicle[key] = value if isinstance(value, str) and key not in SIZES else _number(raw, key, "[vehicle] ")
  if (wrong := next((key for key in SIZES if key in vehicle and float(vehicle[key]) <= 0.0), None)) is not None:
    raise RecordingError(f"{FILE_NAME}: [vehicle] {wrong} must be positive, not {vehicle[wrong]:g}")
  steering = vehicle.get("max_steering", 0.5)
  if float(steering) > math.pi / 2:
    raise RecordingError(
      f"{FILE_NAME}: [vehicle] max_steering is {steering:g} rad, more than a right angle; in degrees? multiply by "
      "0.0174533"
    )
  check_car(vehicle, f"{FILE_NAME}: [vehicle]", table := _table(raw, "std", "[vehicle] "))
  std = _std(table, vehicle)
  check_deviations(vehicle, std, f"{FILE_NAME}: [vehicle.std]")
  return vehicle, std


def _std(raw: Mapping[str, Any], vehicle: Mapping[str, Any]) -> dict[str, float]:
  std = {}
  for key in raw:
    ending = nearest(key, vehicle, cutoff=0.8)
    if key not in vehicle and ending.startswith("; did"):
      raise RecordingError(f"{FILE_NAME}: [vehicle.std] has unknown key '{key}'{ending}")
    std[key] = _number(raw, key, "[vehicle.std] ")
    if std[key] <= 0.0:
      raise RecordingError(
        f"{FILE_NAME}: [vehicle.std] {key} must be positive, not {std[key]:g}; leave it out when it is not known"
      )
  return std


def _mapping(raw: Mapping[str, Any]) -> dict[str, Mapped]:
  mapping = {}
  for channel, table in raw.items():
    where = f"[channels] {channel} "
    if channel not in CHANNELS:
      raise UnknownChannelError(
        f"{FILE_NAME}: [channels] names an unknown channel '{channel}'{nearest(channel, CHANNELS)}"
      )
    if not isinstance(table, dict):
      raise RecordingError(
        f'{FILE_NAME}: {where}must be a table such as {{ column = "log column", scale = 1.0 }}, not {table!r}'
      )
    _only(table, tuple(Mapped.__dataclass_fields__), where)
    mapping[channel] = _mapped(channel, table, where)
  return mapping


def _mapped(channel: str, table: Mapping[str, Any], where: str) -> Mapped:
  for key in () if channel == "time" else ("rate", "steps", "sort"):
    if key in table:
      raise RecordingError(f"{FILE_NAME}: {where}cannot have {key}, which belongs to time")
  for key, only in (("ahead", ("pose_x",)), ("left", ("pose_y",)), ("slope", ("speed", "motor_speed"))):
    if key in table and channel not in only:
      raise RecordingError(f"{FILE_NAME}: {where}cannot have {key}, which belongs to {' and '.join(only)}")
  if channel == "time" and "rate" in table:
    return _fixed_rate(table, where)
  if "column" not in table:
    raise RecordingError(f'{FILE_NAME}: {where}has no column; write {channel} = {{ column = "log column" }}')
  mapped = Mapped(
    _text(table, "column", where, ""),
    _number(table, "scale", where, 1.0),
    _number(table, "offset", where),
    _flag(table, "wrap", where) if "wrap" in table else None,
    _flag(table, "hold", where),
    _text(table, "gate", where, "") if "gate" in table else None,
    _text(table, "signed_by", where, "") if "signed_by" in table else None,
    _number(table, "late", where),
    steps=_flag(table, "steps", where),
    sort=_flag(table, "sort", where),
    ahead=_number(table, "ahead", where),
    left=_number(table, "left", where),
    slope=_flag(table, "slope", where),
    minus=_text(table, "minus", where, "") if "minus" in table else None,
  )
  if mapped.scale == 0.0:
    raise RecordingError(
      f"{FILE_NAME}: {where}scale is 0, which erases the channel; give the factor to SI units or remove the channel"
    )
  return mapped


def _fixed_rate(table: Mapping[str, Any], where: str) -> Mapped:
  """The clock of a log that has none."""
  rate = _number(table, "rate", where)
  if not rate > 0.0 or len(table) > 1:
    raise RecordingError(
      f"{FILE_NAME}: {where}needs a positive rate in Hz and nothing else, as in time = {{ rate = 50.0 }}"
    )
  return Mapped("", rate=rate)


def require_file_name(name: str) -> None:
  """Raises RecordingError for a recording's name that results could not be filed under, or only elsewhere."""
  if not name.strip() or any(ord(mark) < 32 or mark in "/\\\x7f" for mark in name) or name.startswith("."):
    raise RecordingError(f"recording name {name!r:.80} cannot be a file name; use letters, digits, _ and -")


def _only(table: Mapping[str, Any], valid: tuple[str, ...], where: str) -> None:
  for key in table:
    if key not in valid:
      raise RecordingError(f"{FILE_NAME}: {where}has unknown key '{key}'{nearest(key, valid)}")


def _entries(raw: Mapping[str, Any]) -> tuple[Entry, ...]:
  tables = raw.get("recording", [])
  if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
    raise RecordingError(f"{FILE_NAME}: write recordings as [[recording]] tables (two brackets)")
  if not tables:
    raise RecordingError(
      f'{FILE_NAME}: lists no recordings; add [[recording]] tables with file = "…" and role = "identify"'
    )
  entries = tuple(_entry(table, f"[[recording]] {number} ") for number, table in enumerate(tables, 1))
  seen: dict[str, str] = {}
  for entry in entries:
    if entry.name in seen:
      raise RecordingError(
        f"{FILE_NAME}: two recordings have one name, '{entry.name}' ({seen[entry.name]} and {entry.file}); "
        'give one of them another, name = "…"'
      )
    seen[entry.name] = entry.file
  return entries


def _entry(table: Mapping[str, Any], where: str) -> Entry:
  _only(table, _ENTRY, where)
  for key in ("file", "role"):
    if key not in table:
      raise RecordingError(
        f"{FILE_NAME}: {where}has no {key}" + (f"; valid are: {', '.join(ROLES)}" if key == "role" else "")
      )
  file, role = _text(table, "file", where, ""), _text(table, "role", where, "")
  if role not in ROLES:
    raise RecordingError(f"{FILE_NAME}: {where}({file}) has unknown role '{role}'{nearest(role, ROLES)}")
  session = _text(table, "session", where, "") if "session" in table else None
  begin = _number(table, "from", where) if "from" in table else -math.inf
  end = _number(table, "to", where) if "to" in table else math.inf
  if begin >= end:
    raise RecordingError(
      f"{FILE_NAME}: {where}({file}) ends at {end:g} s, before it begins ({begin:g} s); swap from and to"
    )
  part = f"_{begin:g}s" if math.isfinite(begin) else ""
  name = _text(table, "name", where, PurePosixPath(file).stem + part)
  require_file_name(name)
  return Entry(file, role, name, _text(table, "manoeuvre", where, "unspecified"), session, begin, end)
