"""A log that is being written, read piece by piece: rows of a CSV, messages of an MCAP file."""

import codecs
import contextlib
import dataclasses
import io
import itertools
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.extras import extra
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.completed import completed
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.formats.text.encodings import LONGEST_LINE, encoding_of
from qcar_twin.recordings.manifest import Manifest, Mapped
from qcar_twin.recordings.mapping import resolve, streams_of
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from qcar_twin.recordings.row_clock import in_time_order, origin_of, stamps
from qcar_twin.recordings.topic_maps import topic_map

_MAGIC = b"\x89MCAP0\r\n"
_TOLERANCE = 1e-9  # s, within which times are the same, as in a stream
_ANEW = 1.0  # s, by which a clock that begins anew goes back at least
_WHOLE = 1e-6  # of a row: a share of rows is a whole number of them but for rounding
_HEAD = 9  # bytes before a record: its kind and its length
_KEPT = (1, 3, 4)  # kinds of records without which no message can be read: header, schema, channel
_MESSAGES = (5, 6)  # a message, a chunk of them


class Held:
  """Columns of commands as they stood before the oldest row that is kept.

  A log may hold a command only as it changes: its row is forgotten long before the command is.
  """

  def __init__(self) -> None:
    self._columns: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}

  def named(self, table: Table) -> Table:
    """A table with the columns that all its rows lack, blank, so that it is read as before."""
    lacking = [column for column in self._columns if column not in table]
    return dataclasses.replace(table, columns={**table.columns, **{c: np.full(table.rows, np.nan) for c in lacking}})

  def into(self, table: Table, mapping: Mapping[str, Mapped]) -> Table:
    """A table whose first row has, where it is blank, what stood at its time."""
    columns, begin = dict(table.columns), float(stamps(table, mapping["time"])[0])
    for column, (time, value) in self._columns.items():
      row = table.number(column, column).copy()
      if np.isnan(row[0]) and time[0] <= begin <= time[-1]:
        row[0] = value[np.searchsorted(time, begin, side="right") - 1]
        columns[column] = row
    return dataclasses.replace(table, columns=columns)

  def keep(self, table: Table, mapping: Mapping[str, Mapped]) -> None:
    """Take in what a table says of them: each row's value, or the one before it."""
    held = [m for c, m in mapping.items() if CHANNELS[c].is_command or c == "battery_voltage"]
    table, _ = in_time_order(table, mapping)
    time = stamps(table, mapping["time"])
    for column in {c for m in held for c in (m.column, m.gate) if c is not None and c in table}:
      value = table.number(column, column)
      last = np.maximum.accumulate(np.where(np.isnan(value), -1, np.arange(table.rows)))
      self._columns[column] = time, np.where(last < 0, np.nan, value[last])


class Tail(Protocol):
  """What is new in a file.

  Attributes:
    refused: why what is there cannot be read yet; "" where it can.
    torn: how many rows were left out that have other cells than the names.
    grew: how often something whole was appended.
    judged: up to where blocks were handed on, s.
    held: commands as they stood before what is kept.
    later: s by which a table's own `time` begins later than the log, of which the oldest is forgotten.
  """

  refused: str
  torn: int
  grew: int
  judged: float
  held: Held
  later: float

  def grown(self) -> bool:
    """Take in what was appended, or all of a file that is another one by now; whether there was anything whole."""
    ...

  def written(self, folder: Path) -> Path:
    """All that is kept, as a file of its own."""
    ...

  def forget(self, share: float) -> None:
    """Leave out the oldest share of what is kept."""
    ...


def _beginning(file: BinaryIO) -> bytes:
  file.seek(0)
  return file.read(LONGEST_LINE)


def _is_another(file: BinaryIO, begun: bytes, place: int) -> bool:
  """Whether a file was cut by its logger, or is another log of that name: it begins otherwise or is shorter."""
  return not _beginning(file).startswith(begun) or file.seek(0, io.SEEK_END) < place


class CsvTail:
  """Rows of a CSV file; a row that is not ended yet waits, and so does all until the names are there, whose letters
  tell the encoding."""

  def __init__(self, path: Path):
    self._path, self.refused, self.torn, self.grew = path, "", 0, 0
    self._begin()

  def _begin(self) -> None:
    self._place, self._begun, self._undecoded, self._rest = 0, b"", b"", ""
    self._decoder: codecs.IncrementalDecoder | None = None
    self._head: str | None = None
    self._rows: list[str] = []
    self.judged, self.held, self.later = -np.inf, Held(), 0.0

  def grown(self) -> bool:
    with self._path.open("rb") as file:
      if _is_another(file, self._begun, self._place):
        self._begin()
      file.seek(self._place)
      new = file.read()
      self._place, self._begun = file.tell(), _beginning(file)
    *rows, self._rest = (self._rest + self._decoded(new)).split("\n")
    if self._head is None and rows:
      self._head, *rows = rows
    rows = [row for row in rows if row.strip()]
    head = self._head or ""
    mark = max(",;\t", key=head.count)  # a comma may be decimal where the cells are parted by another mark
    width = head.count(mark)
    whole = [row for row in rows if not width or row.count(mark) == width or '"' in row]
    self.torn += len(rows) - len(whole)
    self._rows += whole
    self.grew += bool(rows)
    return bool(rows)

  def _decoded(self, new: bytes) -> str:
    """The letters that are whole; none before the first line is."""
    if self._decoder is None:
      self._undecoded += new
      lines = self._undecoded[: self._undecoded.rfind(b"\n") + 1]
      if not lines:
        return ""
      self._decoder = codecs.getincrementaldecoder(encoding_of(lines[:LONGEST_LINE]))(errors="replace")
      new, self._undecoded = self._undecoded, b""
    return self._decoder.decode(new)

  def written(self, folder: Path) -> Path:
    path = folder / "piece.csv"
    path.write_text("\n".join([self._head or "", *self._rows]) + "\n", encoding="utf-8")
    return path

  def forget(self, share: float) -> None:
    del self._rows[: int(share * len(self._rows) + _WHOLE)]


class McapTail:
  """Records of an MCAP file as they become whole. Most writers write a chunk at a time, of about a megabyte."""

  def __init__(self, path: Path):
    self._path, self.refused, self.torn, self.grew = path, "", 0, 0
    self._begin()

  def _begin(self) -> None:
    self._place, self._begun = len(_MAGIC), b""
    self._always: list[bytes] = []
    self._records: list[bytes] = []
    self._first: int | None = None  # ns, of the log's oldest message, from which on a table's time counts
    self.judged, self.held, self.later = -np.inf, Held(), 0.0

  def grown(self) -> bool:
    with self._path.open("rb") as file:
      if _is_another(file, self._begun, self._place):
        self._begin()
      file.seek(self._place)
      new, self._begun = file.read(), _beginning(file)
    at = 0
    while len(new) - at >= _HEAD:
      kind, size = new[at], int.from_bytes(new[at + 1 : at + _HEAD], "little")
      if len(new) - at - _HEAD < size:
        break
      record = new[at : at + _HEAD + size]
      (self._always if kind in _KEPT else self._records if kind in _MESSAGES else []).append(record)
      at += len(record)
    self._place += at
    self.grew += at > 0
    return at > 0

  def written(self, folder: Path) -> Path:
    with extra("Following MCAP files"):
      from mcap.exceptions import EndOfFile
      from mcap.records import Channel, Message, Schema
      from mcap.stream_reader import StreamReader
      from mcap.writer import Writer
    path = folder / "piece.mcap"
    times: list[int] = []
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
            times.append(record.log_time)
      writer.finish()
    if times:
      self._first = min(times) if self._first is None else self._first
      self.later = 1e-9 * (min(times) - self._first)
    return path

  def forget(self, share: float) -> None:
    count = int(share * len(self._records) + _WHOLE)
    named = _definitions(self._records[:count])  # a writer says once what a channel is, in its first chunk
    self._always += [record for record in named if record not in self._always]
    del self._records[:count]


def _definitions(records: Sequence[bytes]) -> list[bytes]:
  """The schemas and channels of records, those in chunks, too."""
  with extra("Following MCAP files"):
    from mcap.data_stream import RecordBuilder
    from mcap.exceptions import EndOfFile
    from mcap.records import Channel, Schema
    from mcap.stream_reader import StreamReader
  named = []
  with contextlib.suppress(EndOfFile):  # the last record of a file that goes on
    for record in StreamReader(io.BytesIO(b"".join(records)), skip_magic=True).records:
      if isinstance(record, Schema | Channel):
        builder = RecordBuilder()
        record.write(builder)
        named.append(builder.end())
  return named


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


def as_recordings(file: Path, manifest: Manifest, name: str, tail: Tail | None = None) -> list[tuple[Recording, float]]:
  """A piece read as a data set's dataset.toml says, with times of the log's own clock, s: one recording for each time
  the clock began anew, and after which share of the rows it did. Of a tail's file, what it has forgotten holds on: its
  commands and where its time began.

  Raises:
    RecordingError: a channel is missing or holds no numbers.
  """
  held = tail.held if tail else Held()
  table = held.named(read_table(file).named(manifest.columns))
  if tail and tail.later:
    table = dataclasses.replace(table, columns={**table.columns, "time": table.columns["time"] + tail.later})
  said = manifest.mapping
  if manifest.topics:
    said = topic_map(manifest.topics).mapping(table.columns, table.label, said) | said
  mapping = resolve(table, said)
  table = held.into(table, mapping)
  back = np.flatnonzero(np.diff(stamps(table, mapping["time"])) < -_ANEW) + 1
  out, bounds = [], [0, *back.tolist(), table.rows]
  for first, last in itertools.pairwise(bounds):
    part = table.rows_between(first, last)
    streams, _ = streams_of(part, mapping)
    origin = origin_of(stamps(part, mapping["time"]))
    moved = {channel: Stream(s.time + origin, s.value) for channel, s in streams.items()} if origin else streams
    (recording, *_), _ = completed([Recording(name, moved)], manifest.vehicle, table.label)
    out.append((recording, first / table.rows))
  held.keep(table.rows_between(*bounds[-2:]), mapping)
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
      recordings = as_recordings(file, manifest, name, tail)
    except RecordingError as error:
      tail.refused = str(error).replace(str(file), name).replace(file.name, name)
      return  # too little of it yet, or another log
  tail.refused = ""
  new = tail.judged
  for k, (recording, _) in enumerate(recordings):
    start, end = span_of(recording)
    new = new if k == 0 and start <= new <= end else start
    while end - new >= block:
      piece = part_of(recording, max(new - block, start), new + block)
      if piece is not None:
        yield piece, new
      new += block
  tail.judged = new
  recording, before = recordings[-1]
  start, end = span_of(recording)
  if end > start:
    kept = max(0.0, (new - 1.5 * block - start) / (end - start))
    tail.forget(before + (1.0 - before) * kept)


def span_of(recording: Recording) -> tuple[float, float]:
  """First and last time at which something was measured while a command of the drive was known, s.

  A command stands until the next one, so that the last of them ends nothing.
  """
  measured = [stream.time for channel, stream in recording.streams.items() if CHANNELS[channel].is_measured]
  known = float(recording[recording.drive_channel].time[0])
  return max(known, min(float(t[0]) for t in measured)), max(float(t[-1]) for t in measured)


def part_of(recording: Recording, begin: float, end: float) -> Recording | None:
  """The samples from one time to another, s, the latter not included; commands also as they stood before. None where
  nothing was measured between them."""
  near = [t for s in recording.streams.values() for t in s.time[np.abs(s.time - begin) <= _TOLERANCE]]
  try:  # from the sample that is meant by `begin`, which rounding has put a little before it
    return recording.window(min([begin, *near]), np.nextafter(end - _TOLERANCE, -np.inf))
  except RecordingError:
    return None
