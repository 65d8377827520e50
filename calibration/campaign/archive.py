"""All answers of a campaign in one compressed file: to check a page without hours of driving, or go on elsewhere."""

import hashlib
import json
import lzma
from pathlib import Path

from qcar_twin.atomic_io import whole_file, write_text


def digest(answer: dict) -> str:
  """SHA-256 of an answer; it is taken before the truth is looked at."""
  return hashlib.sha256(json.dumps(answer, sort_keys=True).encode()).hexdigest()


def keep(result: dict, path: Path) -> None:
  """Write one answered case, whole or not at all."""
  write_text(path, json.dumps(result, indent=1))


def pack(folder: Path, archive: Path) -> int:
  """Write all answers of a folder into an archive, one JSON object per line; returns how many."""
  answers = [json.loads(path.read_text()) for path in sorted(folder.glob("*_*.json"))]
  with whole_file(archive) as part:
    part.write_bytes(lzma.compress("\n".join(json.dumps(a) for a in answers).encode(), preset=9))
  return len(answers)


def unpack(archive: Path, folder: Path) -> int:
  """Write the answers of an archive into a folder that lacks them; returns how many it lacked.

  Raises:
    ValueError: an answer is not the one its hash was taken of.
  """
  folder.mkdir(parents=True, exist_ok=True)
  lines = lzma.decompress(archive.read_bytes()).decode().splitlines()
  missing = 0
  for result in map(json.loads, lines):
    path = folder / f"{result['case']['name']}.json"
    if digest(result["answer"]) != result["sha256"]:
      raise ValueError(
        f"{archive}: the answer to {path.stem} was changed after its hash was taken; take the archive from its "
        "source again"
      )
    if not path.is_file():
      keep(result, path)
      missing += 1
  return missing
