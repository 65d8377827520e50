"""Where the logs of a fleet lie, whose they are, and of which day."""

import dataclasses
import datetime
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

from qcar_twin.recordings.first_dataset.parts.joined import as_one_drive, joined
from qcar_twin.recordings.first_dataset.parts.pairing import words_of_file
from qcar_twin.recordings.first_dataset.place import is_document, logs_of
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE
from qcar_twin.recordings.manifest import FILE_NAME
from qcar_twin.recordings.recording import RecordingError

_DAY = re.compile(r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])(?!\d)")
_TOPICS = 3  # files of one drive; of two their names tell
_ONE = "car"  # of logs that lie in no folder of a car


@dataclasses.dataclass(frozen=True)
class Log:
  """One log: a data set's folder, or a file that lies in none.

  Attributes:
    place: of it.  name: its path below the folder that is scanned, with forward slashes.
    car: the first folder of that path that is no date; of a data set that is scanned itself, its own.
    day: the last date in the path, as YYYY-MM-DD; else of the file's last change.
    stamp: size in bytes and time of the last change in ns of all its files: whether it is the same as before.
    parts: other files of the same drive, as a motion capture's.
  """

  place: Path
  name: str
  car: str
  day: str
  stamp: tuple[int, int]
  parts: tuple[Path, ...] = ()


def find_logs(folder: Path) -> list[Log]:
  """Data sets and single logs below a folder, by name; results and settings in JSON are none.

  Raises:
    RecordingError: no such folder, or nothing in it that could be read.
  """
  if folder.is_file():
    raise RecordingError(f"{folder}: is a file; name the folder that it lies in")
  if not folder.is_dir():
    raise RecordingError(f"{folder}: no such folder; name one that holds logs or data sets")
  sets = [path.parent for path in sorted(folder.rglob(FILE_NAME)) if not _hidden(path, folder)]
  files: list[Path] = []
  try:
    files = [log for log in logs_of([folder], folder) if not any(s == log or s in log.parents for s in sets)]
  except RecordingError:
    if not sets:
      raise
  single = [file for file in files if not is_document(file)]
  if files and not single and not sets:
    raise RecordingError(f"{folder}: holds no log, but results or settings in JSON, as {files[0].name}")
  parts = _parts(single)
  single = [log for log in single if not any(log in others for others in parts.values())]
  made = (_log(place, folder, parts.get(place, ())) for place in (*sets, *single))
  return sorted(made, key=lambda log: log.name)


def _parts(logs: Sequence[Path]) -> dict[Path, tuple[Path, ...]]:
  """By log the files that hold other parts of its drive and that `new` would join it with: all files of a folder, a
  topic each, or one whose name has one word more or less, or one of the same name in a folder next to its own."""
  parts: dict[Path, tuple[Path, ...]] = {}
  whole_drives: dict[Path, tuple[Path, ...]] = {}
  files = [log for log in logs if log.is_file()]
  for folder in dict.fromkeys(log.parent for log in files):
    own = [log for log in files if log.parent == folder]
    if whole := _topics(own):
      whole_drives[whole[0]] = tuple(whole[1:])
      continue
    for one, other in itertools.combinations(own, 2):
      differs = set(words_of_file(one.stem)) ^ set(words_of_file(other.stem))
      if len(differs) == 1 and not next(iter(differs)).isdigit():
        _add(parts, one, other)
  parts |= whole_drives
  taken = {*parts, *itertools.chain.from_iterable(parts.values())}
  same: dict[tuple[Path, str], list[Path]] = {}
  for log in (log for log in files if log not in taken):
    same.setdefault((log.parent.parent, log.stem), []).append(log)
  for sisters in same.values():
    for one, other in itertools.combinations(sisters, 2):
      if one.parent != other.parent and _first_line(one) != _first_line(other):
        _add(parts, one, other)
  return {log: others for log, others in parts.items() if len(others) == 1 or log in whole_drives}


def _topics(own: Sequence[Path]) -> list[Path]:
  """The files of a folder, where they are three and more, of columns of their own, and one drive; else none."""
  if len(own) < _TOPICS or len({_first_line(log) for log in own}) < len(own):
    return []
  try:
    return list(own) if as_one_drive([read_table(log, log.name) for log in own]) is not None else []
  except RecordingError:  # said where each is read
    return []


def _add(parts: dict[Path, tuple[Path, ...]], one: Path, other: Path) -> None:
  if first := _drive_of(one, other):
    parts[first] = (*parts.get(first, ()), other if first == one else one)


def _drive_of(one: Path, other: Path) -> Path | None:
  """The one of two files that holds the commands of the drive that both are of; None where they are two drives."""
  by_label = {f"{path.parent.name}/{path.name}": path for path in (one, other)}
  try:
    return by_label.get(joined([read_table(path, label) for label, path in by_label.items()]).first)
  except RecordingError:  # said where each is read
    return None


def _first_line(log: Path) -> bytes:
  """What files that were logged alike begin with; of a table in another format its ending stands for it."""
  with log.open("rb") as file:
    head = file.read(LONGEST_LINE)
  return head.split(b"\n")[0] if b"\x00" not in head else log.suffix.lower().encode()


def _hidden(path: Path, folder: Path) -> bool:
  return any(part.startswith(".") for part in path.relative_to(folder).parts)


def _log(place: Path, folder: Path, others: tuple[Path, ...] = ()) -> Log:
  files = [place, *others] if place.is_file() else [path for path in place.rglob("*") if path.is_file()]
  stats = [path.stat() for path in files]
  name = place.relative_to(folder).as_posix()
  parts = name.split("/") if name != "." else [folder.resolve().name]
  folders = parts if place.is_dir() else parts[:-1]  # a data set's own folder may be its car's
  owners = [part for part in folders if not _DAY.search(part)]
  dates = _DAY.findall(name)
  changed = max((s.st_mtime_ns for s in stats), default=0)
  day = "-".join(dates[-1]) if dates else datetime.date.fromtimestamp(changed / 1e9).isoformat()
  return Log(place, name, owners[0] if owners else _ONE, day, (sum(s.st_size for s in stats), changed), others)
