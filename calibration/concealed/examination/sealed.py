"""An exam's folder: what was drawn, the truths nobody can read before all is answered, the answers with their hashes.

    exam.json             commit, generator, number of cases, whether the working tree was clean; the key at the end
    truths/NAME.sealed    a truth, enciphered, with the salted hash it is committed to; written before its answer
    answers/NAME.json     an answer and its SHA-256
    answers.sha256        all hashes; written before the key is told
    key                   32 random bytes, for this folder's user alone, so that an exam can be resumed

A truth is enciphered with SHAKE-256 of key and name. This keeps truths from being met or changed unnoticed. Whoever
runs an exam can still break it: its seeds follow from the commit.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from qcar_twin.atomic_io import plain, write_json, write_text
from qcar_twin.untrusted import read_json

from ..campaign.archive import digest
from ..laboratory.seal import SealError, commitment

PLAN, KEY, HASHES = "exam.json", "key", "answers.sha256"
UNSEALED = " (unsealed)"  # what ends the text that a trial is drawn from


@dataclass(frozen=True)
class Plan:
  """What an exam was drawn from.

  Attributes:
    commit: whose digits cases are drawn from; of a trial its text.
    closed: names of the cases it was closed with, none while it runs.
    code: what a trial was begun with; a sealed exam's is its commit.
  """

  generator: str
  commit: str
  sealed: bool
  cases: int
  closed: tuple[str, ...] = ()
  key: str = ""
  code: str = ""

  @property
  def command(self) -> str:
    """What makes the exam again but for its folder; of a sealed one at its commit."""
    trial = "" if self.sealed else f" --unsealed --trial {shlex.quote(self.commit.removesuffix(UNSEALED))}"
    return f"qcar-twin exam --generator {self.generator} --cases {self.cases}{trial}"


def begin(folder: Path, plan: Plan) -> Plan:
  """Write the plan and a key, or go on with the exam that is there.

  Raises:
    SealError: another exam is there.
  """
  path = folder / PLAN
  if not path.is_file():
    folder.mkdir(parents=True, exist_ok=True)
    with os.fdopen(os.open(folder / KEY, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
      file.write(secrets.token_hex(32))
    write_json(path, asdict(plan))
    return plan
  there = read_plan(folder)
  if there.closed:
    return there
  for name in ("generator", "commit", "sealed", "cases"):
    if getattr(there, name) != getattr(plan, name):
      raise SealError(
        f"{path}: this exam was begun with {name} {getattr(there, name)}, not {getattr(plan, name)}; go back to that,"
        " or choose another --out"
      )
  return there


def read_plan(folder: Path) -> Plan:
  """The plan of a folder. Raises SealError where there is none."""
  if not (folder / PLAN).is_file():
    raise SealError(f"no {PLAN} in {folder}: give the folder that --out named")
  told = read_json(folder / PLAN)
  return Plan(**{**told, "closed": tuple(told["closed"])})


def lock(folder: Path, name: str, truth: dict) -> str:
  """Write a truth enciphered; returns its commitment. The same truth in the same exam gives the same bytes.

  Raises:
    SealError: another truth of this name is committed to.
  """
  key = bytes.fromhex((folder / KEY).read_text())
  text = json.dumps(plain(truth), sort_keys=True).encode()
  mark = commitment(text, _salt(key, name))
  body = {"sha256": mark, "enciphered": _enciphered(text, key, name).hex()}
  path = folder / "truths" / f"{name}.sealed"
  if path.is_file() and read_json(path) != body:
    raise SealError(f"{path}: another truth was committed to; this exam's code or packages have changed since")
  write_text(path, json.dumps(body))
  return mark


def keep_answer(folder: Path, name: str, answer: dict) -> Path:
  """Write an answer with its hash. Raises SealError where its truth is not committed to yet."""
  if not (folder / "truths" / f"{name}.sealed").is_file():
    raise SealError(f"{name}: an answer is kept only after its truth was sealed")
  answer = plain(answer)
  return write_json(folder / "answers" / f"{name}.json", {"answer": answer, "sha256": digest(answer)})


def is_answered(folder: Path, name: str) -> bool:
  return (folder / "answers" / f"{name}.json").is_file()


def close(folder: Path, names: Sequence[str], early: bool = False) -> Plan:
  """Write the hashes of all answers, then the key into the plan; does nothing to an exam that is closed.

  Args:
    names: of all cases.
    early: close with the cases that are answered.

  Raises:
    SealError: cases have no answer, all of them where it is closed early.
  """
  plan = read_plan(folder)
  if plan.closed:
    return plan
  there = [name for name in names if is_answered(folder, name)]
  if len(there) < (1 if early else len(names)):
    raise SealError(f"{len(names) - len(there)} of {len(names)} cases have no answer; truths stay sealed until then")
  hashes = [f"{read_json(folder / 'answers' / f'{name}.json')['sha256']}  {name}" for name in there]
  write_text(folder / HASHES, "\n".join(hashes) + "\n")
  plan = replace(plan, closed=tuple(there), key=(folder / KEY).read_text())
  write_json(folder / PLAN, asdict(plan))
  return plan


def opened(folder: Path) -> list[dict[str, Any]]:
  """Cases of a closed exam: {"name", "truth", "answer", "sha256"}, every hash checked.

  Raises:
    SealError: the exam is not closed, or a truth or an answer is not the one that was committed to.
  """
  plan = read_plan(folder)
  if not plan.closed:
    raise SealError(f"{folder}: the exam is not closed, so its truths stay sealed; answer all cases first")
  key, listed = bytes.fromhex(plan.key), dict(_hash_lines(folder))
  return [_opened(folder, name, key, listed.get(name, "")) for name in plan.closed]


def _opened(folder: Path, name: str, key: bytes, listed: str) -> dict[str, Any]:
  answer = read_json(folder / "answers" / f"{name}.json")
  if not digest(answer["answer"]) == answer["sha256"] == listed:
    raise SealError(f"{name}: the answer was changed after its hash was taken; its case counts no more")
  body = read_json(folder / "truths" / f"{name}.sealed")
  text = _enciphered(bytes.fromhex(body["enciphered"]), key, name)
  if commitment(text, _salt(key, name)) != body["sha256"]:
    raise SealError(f"{name}: the truth is not the one that was committed to; its case counts no more")
  return {"name": name, "truth": json.loads(text), **answer}


def _hash_lines(folder: Path) -> list[tuple[str, str]]:
  rows = [line.split() for line in (folder / HASHES).read_text().splitlines()]
  return [(name, mark) for mark, name in rows]


def _salt(key: bytes, name: str) -> bytes:
  return hmac.digest(key, name.encode(), "sha256")[:16]


def _enciphered(text: bytes, key: bytes, name: str) -> bytes:
  """Text with a key stream added bit by bit; applied twice it is the text."""
  stream = hashlib.shake_256(key + name.encode()).digest(len(text))
  return bytes(a ^ b for a, b in zip(text, stream, strict=True))
