"""Sealed truth: written apart from the data, packed so that nobody reads it by accident, committed to by a salted hash.

The commitment is SHA-256(truth || salt), truth being the exact bytes of the JSON text. The salt stays with the truth.
"""

from __future__ import annotations

import base64
import hashlib
import json
import secrets
import zlib
from pathlib import Path

from qcar_twin.atomic_io import write_text
from qcar_twin.untrusted import MOST_JSON, read_json

PLAIN, PACKED, COMMITMENT = "truth.json", "truth.sealed", "truth.sha256"


class SealError(ValueError):
  """A truth that is missing, in the wrong place, or not the one that was committed to."""


def commitment(truth: bytes, salt: bytes) -> str:
  """SHA-256(truth || salt), hexadecimal."""
  return hashlib.sha256(truth + salt).hexdigest()


def seal(truth: dict, data: Path, out: Path, packed: bool = False, salt: bytes | None = None) -> str:
  """Write the truth to the folder `out` and its commitment to `data`/truth.sha256; returns the commitment.

  Raises SealError when `out` lies inside `data`, or a truth of `data` was sealed before. `packed` compresses and
  encodes, so that a search does not meet the text.
  """
  data, out = Path(data).resolve(), Path(out).resolve()
  if out == data or data in out.parents:
    raise SealError(f"the truth must not lie with the data: choose a folder outside {data} instead of {out}")
  if (data / COMMITMENT).exists():
    raise SealError(f"{data} holds a data set whose truth was sealed, and would be lost: name another folder")
  text = json.dumps(truth, indent=1, sort_keys=True).encode()
  salt = secrets.token_bytes(16) if salt is None else salt
  mark = commitment(text, salt)
  body = {"salt": salt.hex(), "sha256": mark}
  if packed:
    content = json.dumps(body | {"packed": base64.b85encode(zlib.compress(text, 9)).decode()})
  else:
    content = json.dumps(body | {"truth": json.loads(text)}, indent=1, sort_keys=True)
  write_text(out / (PACKED if packed else PLAIN), content)
  write_text(data / COMMITMENT, mark + "\n")
  return mark


def unseal(folder: Path, published: str | None = None) -> dict:
  """The truth in a folder, checked against its own hash and, when given, the published one. Raises SealError."""
  folder = Path(folder)
  sealed = [folder / name for name in (PLAIN, PACKED) if (folder / name).exists()]
  if not sealed:
    raise SealError(f"no {PLAIN} or {PACKED} in {folder}: give the folder that --truth-out named")
  try:
    return _opened(read_json(sealed[0]), sealed[0].name, published)
  except (KeyError, TypeError, ValueError, zlib.error) as error:
    if isinstance(error, SealError):
      raise
    raise SealError(f"{sealed[0].name} is damaged ({error}); take it from its source again") from error


def _opened(body: dict, name: str, published: str | None) -> dict:
  if "packed" in body:
    text = zlib.decompressobj().decompress(base64.b85decode(body["packed"]), MOST_JSON)
  else:
    text = json.dumps(body["truth"], indent=1, sort_keys=True).encode()
  mark = commitment(text, bytes.fromhex(body["salt"]))
  if mark != body["sha256"] or (published is not None and mark != published.strip()):
    raise SealError(f"{name} is not the truth that was committed to: its hash is {mark}")
  return json.loads(text)
