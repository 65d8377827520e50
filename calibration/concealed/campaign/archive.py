"""All answers of a campaign in one compressed file: to check a page without hours of driving, or go on elsewhere."""

import hashlib
import json
import lzma
from collections.abc import Mapping
from pathlib import Path

from qcar_twin.atomic_io import whole_file, write_text
from qcar_twin.untrusted import MOST_JSON, SPARE_MEMORY, UnreadableFile, inside, require_file

MOST_UNPACKED = 1 << 29  # bytes of answers: a campaign of thousands of cases

# keys under which earlier answers were sealed, and those of now
_OF_ANSWER = {
  "possible": "below_detection_size",
  "rival": "alternative",
  "left_over": "residual_structure",
}
_OF_CLAIM = {"rivals": "alternatives", "equivalent_to": "indistinguishable_from"}


def digest(answer: dict) -> str:
  """SHA-256 of an answer; it is taken before the truth is looked at."""
  return hashlib.sha256(json.dumps(answer, sort_keys=True).encode()).hexdigest()


def keep(result: dict, path: Path) -> None:
  """Write one answered case, whole or not at all."""
  write_text(path, json.dumps(result, indent=1))


def read_answer(path: Path) -> dict:
  """An answered case, its answer under the keys of now. The file stays as it was sealed, so its hash holds."""
  result = json.loads(path.read_text())
  answer = _renamed(result["answer"], _OF_ANSWER)
  if "claims" in answer:  # of free curves an answer has none
    answer["claims"] = [_renamed(row, _OF_CLAIM) for row in answer["claims"]]
  return result | {"answer": answer}


def _renamed(row: dict, keys: Mapping[str, str]) -> dict:
  return {keys.get(key, key): value for key, value in row.items()}


def pack(folder: Path, archive: Path) -> int:
  """Write all answers of a folder into an archive, one JSON object per line; returns how many."""
  answers = [json.loads(path.read_text()) for path in sorted(folder.glob("*_*.json"))]
  with whole_file(archive) as part:
    part.write_bytes(lzma.compress("\n".join(json.dumps(a) for a in answers).encode(), preset=9))
  return len(answers)


def unpack(archive: Path, folder: Path) -> int:
  """Write the answers of an archive into a folder that lacks them; returns how many it lacked.

  Raises:
    UnreadableFile: it is no archive, or an answer is not the one its hash was taken of.
  """
  folder.mkdir(parents=True, exist_ok=True)
  missing = 0
  for result in answers_of(archive):
    try:
      path = inside(folder, f"{result['case']['name']}.json")
    except UnreadableFile as error:
      raise UnreadableFile(f"{archive}: {error}") from error
    if digest(result["answer"]) != result["sha256"]:
      raise UnreadableFile(
        f"{archive}: the answer to {path.stem} was changed after its hash was taken; take the archive from its "
        "source again"
      )
    if not path.is_file():
      keep(result, path)
      missing += 1
  return missing


def answers_of(archive: Path) -> list[dict]:
  """The answers in an archive. Raises UnreadableFile where it is none."""
  require_file(archive, MOST_JSON)
  reader = lzma.LZMADecompressor(memlimit=SPARE_MEMORY)
  try:
    text = reader.decompress(archive.read_bytes(), MOST_UNPACKED)
    if not reader.eof:
      raise UnreadableFile(f"{archive}: is cut off, or unpacks to more than {MOST_UNPACKED >> 20} MiB; fetch it again")
    answers = [json.loads(line) for line in text.decode().splitlines()]
    if not all(isinstance(a["case"]["name"], str) and {"answer", "sha256"} <= set(a) for a in answers):
      raise ValueError("an answer without its case or hash")
  except UnreadableFile:
    raise
  except (lzma.LZMAError, ValueError, KeyError, TypeError, RecursionError) as error:
    raise UnreadableFile(f"{archive}: is no archive of answers ({error}); take it from its source again") from error
  return answers
