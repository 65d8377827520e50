"""A log that is being written, read piece by piece: rows of a CSV, messages of an MCAP file."""

import contextlib
import io
import itertools
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

from qcar_twin.extras import extra
from qcar_twin.recordings.completed import completed
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.manifest import Manifest
from qcar_twin.recordings.mapping import resolve, streams_of
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from qcar_twin.recordings.row_clock import origin_of, stamps
from qcar_twin.recordings.topic_maps import topic_map

_MAGIC = b"\x89MCAP0\r\n"
_ANEW = 1.0  # s, by which a clock that begins anew goes back at least
_HEAD = 9  # bytes before a record: its kind and its length
_KEPT = (1, 3, 4)  # kinds of records without which no message can be read: header, schema, channel
_MESSAGES = (5, 6)  # a message, a chunk of them


class Tail(Protocol):
  """What is new in a file.

  Attributes:
    refused: why what is there cannot be read yet; "" where it can.
    torn: how many rows were left out that have other cells than the names.
  """

  refused: str
  torn: int

  def grown(self) -> bool:
    """Take in what was appended; whether there was anything whole."""
    ...

  def written(self, folder: Path) -> Path:
    """All that is kept, as a file of its own."""
    ...

  def forget(self, share: float) -> None:
    """Leave out the oldest share of what is kept."""
    ...


class CsvTail:
  """Rows of a CSV file; a row that is not ended yet waits."""

  def __init__(self, path: Path):
    self._path, self._place, self._rest, self.refused, self.torn = path, 0, "", "", 0
    self._head: str | None = None
    self._rows: list[str] = []

  def grown(self) -> bool:
    with self._path.open("rb") as file:
      file.seek(self._place)
      new = file.read()
      self._place = file.tell()
    text = self._rest + new.decode("utf-8", errors="replace")
    *rows, self._rest = text.split("\n")
    if self._head is None and rows:
      self._head, *rows = rows
    rows = [row for row in rows if row.strip()]
    head = self._head or ""
    mark = max(",;\t", key=head.count)  # a comma may be decimal where the cells are parted by another mark
    width = head.count(mark)
    whole = [row for row in rows if not width or row.count(mark) == width or '"' in row]
    self.torn += len(rows) - len(whole)
    self._rows += whole
    return bool(rows)

  def written(self, folder: Path) -> Path:
    path = folder / "piece.csv"
    path.write_text("\n".join([self._head or "", *self._rows]) + "\n", encoding="utf-8")
    return path

  def forget(self, share: float) -> None:
    del self._rows[: int(share * len(self._rows))]


class McapTail:
  """Records of an MCAP file as they become whole. Most writers write a chunk at a time, of about a megabyte."""

  def __init__(self, path: Path):
    self._path, self._place, self.refused, self.torn = path, len(_MAGIC), "", 0
    self._always: list[bytes] = []
    self._records: list[bytes] = []

  def grown(self) -> bool:
    with self._path.open("rb") as file:
      file.seek(self._place)
      new = file.read()
    at = 0
    while len(new) - at >= _HEAD:
      kind, size = new[at], int.from_bytes(new[at + 1 : at + _HEAD], "little")
      if len(new) - at - _HEAD < size:
        break
      record = new[at : at + _HEAD + size]
      (self._always if kind in _KEPT else self._records if kind in _MESSAGES else []).append(record)
      at += len(record)
    self._place += at
    return at > 0

  def written(self, folder: Path) -> Path:
    with extra("Following MCAP files"):
      from mcap.exceptions import EndOfFile
      from mcap.records import Channel, Message, Schema
      from mcap.stream_reader import StreamReader
      from mcap.writer import Writer
    path = folder / "piece.mcap"
    stream = io.BytesIO(b"".join([*self._always, *self._records]))
    with path.open("wb") as file:
      writer, schemas, channels = Writer(file), {0: 0}, {}
      writer.start()
      with contextlib.suppress(EndOfFile):  # the last record of a file that goes on
        for record in StreamReader(stream, skip_magic=True).records:
          if isinstance(record, Schema):
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
          elif isinstance(record, Channel) and record.id not in channels:
            encoding = record.message_encoding
            channels[record.id] = writer.register_channel(record.topic, encoding, schemas[record.schema_id])
          elif isinstance(record, Message) and record.channel_id in channels:
            writer.add_message(channels[record.channel_id], record.log_time, record.data, record.publish_time)
      writer.finish()
    return path

  def forget(self, share: float) -> None:
    del self._records[: int(share * len(self._records))]


def tail_of(path: Path) -> Tail:
  """By the file's suffix.

  Raises:
    RecordingError: no such file, or one that cannot be read while it is written.
  """
  if path.is_dir():
    raise RecordingError(f"{path}: is a folder; name the file in it that is being written")
  if not path.is_file():
    raise RecordingError(f"{path}: no such file; start the log first")
  kinds = {".csv": CsvTail, ".mcap": McapTail}
  if path.suffix.lower() not in kinds:
    raise RecordingError(f"{path}: only {' and '.join(kinds)} can be followed while they are written")
  return kinds[path.suffix.lower()](path)


def as_recordings(file: Path, manifest: Manifest, name: str) -> list[tuple[Recording, int]]:
  """A piece read as a data set's dataset.toml says, with times of the log's own clock, s: one recording for each time
  the clock began anew, and at which row it did.

  Raises:
    RecordingError: a channel is missing or holds no numbers.
  """
  table = read_table(file)
  said = manifest.mapping
  if manifest.topics:
    said = topic_map(manifest.topics).mapping(table.columns, table.label, said) | said
  table = table.named(manifest.columns)
  mapping = resolve(table, said)
  back = np.flatnonzero(np.diff(stamps(table, mapping["time"])) < -_ANEW) + 1
  out = []
  for first, last in itertools.pairwise([0, *back.tolist(), table.rows]):
    part = table.rows_between(first, last)
    streams, _ = streams_of(part, mapping)
    origin = origin_of(stamps(part, mapping["time"]))
    moved = {channel: Stream(s.time + origin, s.value) for channel, s in streams.items()} if origin else streams
    (recording, *_), _ = completed([Recording(name, moved)], manifest.vehicle, table.label)
    out.append((recording, first))
  return out


def pieces(tail: Tail, manifest: Manifest, name: str, block: float) -> Iterator[tuple[Recording, float]]:
  """What is new, two blocks at a time, the first of which is there for the twin to settle in.

  Yields:
    a recording of whole blocks, and the time from which on it is new, s. Ends when the file holds no more for now.
  """
  if not tail.grown():
    return
  with tempfile.TemporaryDirectory() as folder:
    file = tail.written(Path(folder))
    try:
      recordings = as_recordings(file, manifest, name)
    except RecordingError as error:
      tail.refused = (
        str(error).replace(str(file), name).replace(file.name, name)
      )  # too little of it yet, or another log
      return
  tail.refused = ""
  new = getattr(tail, "judged", -np.inf)
  for k, (recording, _) in enumerate(recordings):
    start, end = span_of(recording)
    new = new if k == 0 and start <= new <= end else start
    while end - new >= block:
      begin = max(new - block, start)
      yield part_of(recording, begin, new + block), new
      new += block
  tail.judged = new  # type: ignore[attr-defined]
  recording, first = recordings[-1]
  start, end = span_of(recording)
  if end > start:
    kept = max(0.0, (new - 1.5 * block - start) / (end - start))
    before = first / (first + len(recording[recording.drive_channel].time))
    tail.forget(before + (1.0 - before) * kept)


def span_of(recording: Recording) -> tuple[float, float]:
  """First and last time of the drive's command, s."""
  time = recording[recording.drive_channel].time
  return float(time[0]), float(time[-1])


def part_of(recording: Recording, begin: float, end: float) -> Recording:
  """The samples from one time to another, the latter not included; commands also as they stood before."""
  streams = {}
  for channel, stream in recording.streams.items():
    rows = (stream.time >= begin - 1e-9) & (stream.time < end - 1e-9)
    if np.any(rows):
      streams[channel] = Stream(stream.time[rows], stream.value[rows])
  return Recording(recording.name, streams)
