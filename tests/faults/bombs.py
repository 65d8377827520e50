"""Files made to do harm: lengths that are not there, a thousand times unpacked, nested without end, code, other files.

Every entry of BOMBS writes into the folder of a good sample of a kind, whose reader it is meant for.
"""

import io
import lzma
import pickle
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet

ZEROS = bytes(1 << 20)
BIG = 1600  # MiB that a bomb unpacks to, more than a reader may take


class Crack:
  """Leaves a file where it is unpickled."""

  def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
    return _leave_a_mark, ("cracked",)


def _leave_a_mark(name: str) -> None:
  Path(name).write_text("executed", encoding="utf-8")


def _npy_header(shape: str, kind: str = "'<f8'") -> bytes:
  text = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}"
  text += " " * (-(len(text) + 11) % 64) + "\n"
  return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def _npz_with(header: bytes, body: int = 0, name: str = "time.npy") -> Callable[[Path], None]:
  def write(folder: Path) -> None:
    with zipfile.ZipFile(folder / "run.npz", "w", zipfile.ZIP_DEFLATED) as archive:
      with archive.open(name, "w", force_zip64=True) as part:
        part.write(header)
        for _ in range(body):
          part.write(ZEROS)

  return write


def _npz_pickle(folder: Path) -> None:
  np.savez(folder / "run.npz", time=np.array([Crack()], dtype=object), speed=np.zeros(1))


def _csv(text: Callable[[], str]) -> Callable[[Path], None]:
  return lambda folder: (folder / "run.csv").write_text(text(), encoding="utf-8") and None


def _parquet_rows(folder: Path) -> None:
  """Three thousand million equal values in a few kilobytes."""
  chunk = pyarrow.table({"time": np.zeros(1 << 22), "motor_voltage": np.zeros(1 << 22), "speed": np.zeros(1 << 22)})
  with pyarrow.parquet.ParquetWriter(folder / "run.parquet", chunk.schema, compression="zstd") as writer:
    for _ in range(BIG >> 5):
      writer.write_table(chunk)


def _mat_bomb(folder: Path) -> None:
  """A compressed element of zeros that unpacks to gigabytes."""
  squeeze = zlib.compressobj(9)
  element = struct.pack("<II", 14, BIG << 20) + struct.pack("<IIII", 6, 8, 6, 0)  # miMATRIX, flags: double
  element += struct.pack("<IIii", 5, 8, 1, (BIG << 20) // 8) + struct.pack("<II", 1, 4) + b"time" + bytes(4)
  element += struct.pack("<II", 9, (BIG << 20) - 64)
  packed = squeeze.compress(element) + b"".join(squeeze.compress(ZEROS) for _ in range(BIG)) + squeeze.flush()
  head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
  (folder / "run.mat").write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)


def _db3(statement: str) -> Callable[[Path], None]:
  def write(folder: Path) -> None:
    file = next((folder / "drive").glob("*.db3"))
    with sqlite3.connect(file) as base:
      base.executescript(statement)
    base.close()

  return write


def _metadata(change: Callable[[str], str]) -> Callable[[Path], None]:
  def write(folder: Path) -> None:
    file = folder / "drive" / "metadata.yaml"
    file.write_text(change(file.read_text(encoding="utf-8")), encoding="utf-8")

  return write


def _laughs(text: str) -> str:
  """Ten references to ten references to …: an alias bomb."""
  lines = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
  lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
  return text + "\n" + "\n".join(lines) + "\n"


def _text(file: str, content: Callable[[], str]) -> Callable[[Path], None]:
  return lambda folder: (folder / file).write_text(content(), encoding="utf-8") and None


def _weights(header: bytes, claimed: int | None = None) -> Callable[[Path], None]:
  data = struct.pack("<Q", len(header) if claimed is None else claimed) + header
  return lambda folder: (folder / "policy.safetensors").write_bytes(data) and None


def _archive(folder: Path) -> None:
  squeeze = lzma.LZMACompressor(preset=1)
  parts = [squeeze.compress(ZEROS) for _ in range(BIG >> 1)]
  (folder / "answers.jsonl.xz").write_bytes(b"".join([*parts, squeeze.flush()]))


def _archive_of(text: str) -> Callable[[Path], None]:
  return lambda folder: (folder / "answers.jsonl.xz").write_bytes(lzma.compress(text.encode())) and None


def _pickled(file: str) -> Callable[[Path], None]:
  stream = io.BytesIO()
  pickle.dump(Crack(), stream)
  return lambda folder: (folder / file).write_bytes(stream.getvalue()) and None


_HUGE = b'{"weight_0":{"dtype":"F32","shape":[4294967296,4294967296],"data_offsets":[0,0]}}'
_LONG = "a." * 250_000 + "b = 1"
BOMBS: dict[str, tuple[str, Callable[[Path], None]]] = {
  "npz of a huge shape": ("npz", _npz_with(_npy_header("(1099511627776,)"))),
  "npz of a negative shape": ("npz", _npz_with(_npy_header("(-5,)"), 1)),
  "npz that unpacks to gigabytes": ("npz", _npz_with(_npy_header(f"({BIG << 17},)"), BIG)),
  "npz whose header is code": ("npz", _npz_with(_npy_header("(__import__('os').system('touch cracked'),)"))),
  "npz of objects": ("npz", _npz_pickle),
  "npz of a name that leads out": ("npz", _npz_with(_npy_header("(1,)"), 0, "../../time.npy")),
  "a pickle called npz": ("npz", _pickled("run.npz")),
  "a pickle called mat": ("mat", _pickled("run.mat")),
  "a pickle called safetensors": ("policy.safetensors", _pickled("policy.safetensors")),
  "csv of a million columns": ("csv", _csv(
    lambda: ",".join(f"c{k}" for k in range(1_000_000)) + "\n" + "1," * 999_999)),
  "csv of one endless line": ("csv", _csv(lambda: "time,motor_voltage,speed" + "x" * (64 << 20))),
  "csv of empty lines": ("csv", _csv(lambda: "time,motor_voltage,speed\n" + "\n" * (32 << 20))),
  "csv of texts": ("csv", _csv(lambda: "time,motor_voltage,speed\n" + "a,b,c\n" * 2_000_000)),
  "csv of an open quote": ("csv", _csv(lambda: 'time,motor_voltage,speed\n"' + "1,2,3\n" * 2_000_000)),
  "csv of centuries": ("csv", _csv(lambda: "time,motor_voltage,speed\n" + "".join(
    f"{k + (k > 50) * 1e11},1,1\n" for k in range(100)))),
  "parquet of endless rows": ("parquet", _parquet_rows),
  "mat that unpacks to gigabytes": ("mat", _mat_bomb),
  "sqlite that never ends": ("ros2 sqlite", _db3(
    "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
    "SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(12) AS data FROM n;")),
  "bag metadata of aliases": ("ros2 sqlite", _metadata(_laughs)),
  "bag metadata of code": ("ros2 sqlite", _metadata(
    lambda text: text + "\nx: !!python/object/apply:os.system ['touch cracked']\n")),
  "bag metadata that leads out": ("ros2 sqlite", _metadata(
    lambda text: text.replace("drive.db3", "../../secret/drive.db3"))),
  "toml of brackets": ("dataset.toml", _text("dataset.toml", lambda: "a = " + "[" * 500_000)),
  "toml of a deep key": ("dataset.toml", _text("dataset.toml", lambda: _LONG)),
  "toml of a huge number": ("twin.toml", _text("twin.toml", lambda: "format = " + "9" * 900_000)),
  "toml of megabytes": ("vehicle.toml", _text("car.toml", lambda: "#" * (30 << 20))),
  "json of brackets": ("policy.json", _text("policy.json", lambda: "[" * 5_000_000)),
  "json of a huge number": ("policy.json", _text("policy.json", lambda: '{"format": 1, "layers": ' + "9" * 4000 + "}")),
  "weights of a huge shape": ("policy.safetensors", _weights(_HUGE)),
  "weights of a huge header": ("policy.safetensors", _weights(b"{}", 1 << 62)),
  "weights of a header of brackets": ("policy.safetensors", _weights(b'{"a":' + b"[" * 5_000_000)),
  "archive that unpacks to gigabytes": ("answers.xz", _archive),
  "archive of a name that leads out": ("answers.xz", _archive_of(
    '{"case": {"name": "../../cracked"}, "answer": {}, '
    '"sha256": "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a"}')),
}  # fmt: skip
HEAVY = tuple(name for name in BOMBS if "gigabytes" in name or "endless rows" in name)  # take long to make
