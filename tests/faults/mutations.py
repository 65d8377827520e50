"""Damage to files, decided by a seed: cut off, overwritten, wrong types, huge numbers, other encodings."""

import re
from collections.abc import Callable

import numpy as np

Random = np.random.Generator
NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_]{2,}")
LENGTHS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)
VALUES = (
  b"NaN", b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e999", b"1e-320", b"9" * 400, b"9" * 5000, b"0", b"-1", b"",
  b"text", b'"text"', b"true", b"null", b"[]", b"{}", b"[1.0, 2.0]", b"2024-01-01", b"0xffffffffffffffffff", b"1,5",
  b"\xc3\xa9", b"\x00", b"99999999999999999999", b"1_000", b"'", b'"', b"=", b"__import__('os')", b"../../etc/passwd",
)  # fmt: skip


def _span(data: bytes, random: Random, most: int = 64) -> tuple[int, int]:
  start = int(random.integers(len(data) + 1))
  return start, min(len(data), start + int(random.integers(1, most)))


def cut_off(data: bytes, random: Random) -> bytes:
  return data[: int(random.integers(len(data) + 1))]


def bits(data: bytes, random: Random) -> bytes:
  out = np.frombuffer(data, np.uint8).copy()
  if out.size:
    at = random.integers(out.size, size=int(random.integers(1, 9)))
    out[at] ^= (1 << random.integers(8, size=at.size)).astype(np.uint8)
  return out.tobytes()


def overwritten(data: bytes, random: Random) -> bytes:
  start, end = _span(data, random)
  filling = (bytes(end - start), b"\xff" * (end - start), random.bytes(end - start))[int(random.integers(3))]
  return data[:start] + filling + data[end:]


def doubled(data: bytes, random: Random) -> bytes:
  start, end = _span(data, random, 512)
  return data[:end] + data[start:end] * int(random.integers(1, 20)) + data[end:]


def left_out(data: bytes, random: Random) -> bytes:
  start, end = _span(data, random, 512)
  return data[:start] + data[end:]


def inserted(data: bytes, random: Random) -> bytes:
  start, _ = _span(data, random)
  return data[:start] + random.bytes(int(random.integers(1, 64))) + data[start:]


def moved(data: bytes, random: Random) -> bytes:
  start, end = _span(data, random, 256)
  rest, at = data[:start] + data[end:], int(random.integers(len(data) + 1))
  return rest[:at] + data[start:end] + rest[at:]


def lengths(data: bytes, random: Random) -> bytes:
  """An integer in the file becomes another one, small or huge."""
  width = int(random.choice([1, 2, 4, 8]))
  if len(data) < width:
    return data
  at = int(random.integers(len(data) - width + 1))
  value = LENGTHS[int(random.integers(len(LENGTHS)))] & ((1 << (8 * width)) - 1)
  return data[:at] + value.to_bytes(width, "little" if random.random() < 0.7 else "big") + data[at + width :]


def _replaced(data: bytes, random: Random, pattern: re.Pattern[bytes]) -> bytes:
  matches = list(pattern.finditer(data))
  if not matches:
    return data
  match = matches[int(random.integers(len(matches)))]
  return data[: match.start()] + VALUES[int(random.integers(len(VALUES)))] + data[match.end() :]


def numbers(data: bytes, random: Random) -> bytes:
  return _replaced(data, random, NUMBER)


def words(data: bytes, random: Random) -> bytes:
  return _replaced(data, random, WORD)


def lines(data: bytes, random: Random) -> bytes:
  """Lines are exchanged, repeated or lost."""
  parts = data.split(b"\n")
  one, other = random.integers(len(parts), size=2)
  way = int(random.integers(3))
  if way == 0:
    parts[one], parts[other] = parts[other], parts[one]
  elif way == 1:
    parts.insert(int(other), parts[one])
  else:
    del parts[one]
  return b"\n".join(parts)


def encoded(data: bytes, random: Random) -> bytes:
  encoding = str(random.choice(["utf-16", "utf-16-be", "utf-32", "utf-8-sig", "cp037", "utf-7"]))
  return data.decode("utf-8", errors="replace").encode(encoding, errors="replace")


def separated(data: bytes, random: Random) -> bytes:
  marks = (b",", b";", b"\t", b".", b"=", b"[", b"]", b'"', b"\n", b"\r\n", b" ", b":", b"{", b"}")
  one, other = (marks[int(k)] for k in random.integers(len(marks), size=2))
  return data.replace(one, other, int(random.integers(1, 50)))


BINARY: tuple[Callable[[bytes, Random], bytes], ...] = (
  cut_off, bits, overwritten, doubled, left_out, inserted, moved, lengths, lengths,
)  # fmt: skip
TEXT = (*BINARY, numbers, numbers, numbers, words, words, lines, lines, encoded, separated)


def damaged(data: bytes, seed: int, text: bool) -> bytes:
  """The file damaged once in most cases, else several times."""
  random = np.random.default_rng(seed)
  kinds = TEXT if text else BINARY
  for _ in range(int(random.geometric(0.6))):
    data = kinds[int(random.integers(len(kinds)))](data, random)
  return data
