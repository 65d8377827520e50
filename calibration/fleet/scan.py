"""Logs of a fleet checked one by one, a line of NDJSON each; a scan that was stopped goes on where it was.

A line has `log`, `car`, `day`, `stamp`, `level`, `like` (digest of the dataset.toml it was read like; "" for none),
`state` (`fit`, `beware`, `refused`), `verdict`, `findings`, `driven` [s], `seconds`; from level `calibrate` on
`parameters`, by name `value`, `std`, `unit`, of those that the driving shows; at level `diagnose` `diagnosis`, its
verdict and claims.
"""

import dataclasses
import hashlib
import json
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import joblib

from calibration.diagnosis.pipeline import diagnose
from calibration.diagnosis.search.structure import NARROW
from calibration.fleet.logs import Log
from calibration.log_check.check import LogCheck, check_log, load_to_check
from calibration.progress import silent
from calibration.twin_calibration.calibration import calibrate
from qcar_twin.atomic_io import plain, write_text
from qcar_twin.parallel import in_parallel
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.parts.drives import drives_of
from qcar_twin.recordings.first_dataset.place import placed
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.manifest import FILE_NAME
from qcar_twin.recordings.recording import RecordingError

Level = Literal["check", "calibrate", "diagnose"]
_SHOWN = 0.5  # of the prior's variance: below it the driving says more of a parameter than was known before


def scan(
  logs: Sequence[Log], lines: Path, level: Level = "check", like: Path | None = None, workers: int = 1,
  said: Callable[[dict[str, Any]], None] = lambda line: None,
) -> list[dict[str, Any]]:  # fmt: skip
  """Lines of all logs, in their order; those that `lines` holds already, of the same files, level and `like`, are not
  redone; one that does not say what it was read like, is.

  Args:
    lines: NDJSON file; each log is appended as it is done. Half a line at its end, of a scan that was killed, is cut.
    like: folder with a dataset.toml whose [channels] and [vehicle] hold for single logs, too.
    workers: processes.
    said: called with every new line.
  """
  read_like = _digest(like)
  known = {(line["log"], tuple(line["stamp"]), line["level"], line.get("like")): line for line in read_lines(lines)}
  key = lambda log: (log.name, log.stamp, level, read_like)
  todo = [log for log in logs if key(log) not in known]
  lines.parent.mkdir(parents=True, exist_ok=True)
  _cut_torn_end(lines)
  with lines.open("a", encoding="utf-8") as file:
    for index, made in in_parallel([joblib.delayed(line_of)(log, level, like) for log in todo], workers):
      text = json.dumps(plain(made), ensure_ascii=False, allow_nan=False)
      line = json.loads(text)  # as it is read again
      file.write(text + "\n")
      file.flush()
      known[key(todo[index])] = line
      said(line)
  return [known[key(log)] for log in logs]


def _digest(like: Path | None) -> str:
  """What tells the dataset.toml of a folder from another one; "" without a folder."""
  return hashlib.sha256((like / FILE_NAME).read_bytes()).hexdigest()[:12] if like is not None else ""


def read_lines(path: Path) -> Iterator[dict[str, Any]]:
  """Whole lines of an NDJSON file; none where there is no file.

  Raises:
    ValueError: a line in its middle is no JSON, with its number.
  """
  if not path.is_file():
    return
  whole = path.read_text(encoding="utf-8").split("\n")
  for number, text in enumerate(whole[:-1], 1):  # the last one was not ended: it is done again
    if not text:
      continue
    try:
      line = json.loads(text)
      if not {"log", "stamp", "level"} <= line.keys():
        raise ValueError("no log, stamp or level")
    except (ValueError, AttributeError) as error:
      raise ValueError(
        f"{path}, line {number}: is no line of a scan ({error}); remove it, or name another --out"
      ) from error
    yield line


def _cut_torn_end(path: Path) -> None:
  if path.is_file() and (text := path.read_bytes()) and not text.endswith(b"\n"):
    path.write_bytes(text[: text.rfind(b"\n") + 1])


def line_of(log: Log, level: Level, like: Path | None = None) -> dict[str, Any]:
  """What a scan says of one log. Whatever is wrong with it is said in its line, and stops no other."""
  began = time.perf_counter()
  line: dict[str, Any] = {"log": log.name, "car": log.car, "day": log.day, "stamp": list(log.stamp), "level": level}
  line["like"] = _digest(like)
  try:
    with tempfile.TemporaryDirectory() as folder:
      dataset = _dataset(log, Path(folder), like)
      check = check_log(dataset)
      line |= _checked(check)
      if level != "check" and line["state"] != "refused":
        line |= _fitted(dataset, level)
  except RecordingError as error:
    line |= {"state": "refused", "verdict": " ".join(str(error).split()), "findings": []}
  except Exception as error:  # of a file that somebody wrote: the next log is not its fault
    line |= {"state": "refused", "verdict": f"{type(error).__name__}: {' '.join(str(error).split())}", "findings": []}
  return line | {"seconds": round(time.perf_counter() - began, 3)}


def _dataset(log: Log, folder: Path, like: Path | None) -> DataSet:
  """A data set as it lies there; a single log as `new` would guess it, or read like another data set."""
  if log.place.is_dir() and (log.place / FILE_NAME).is_file():
    return load_to_check(log.place)
  place = folder / (log.place.stem or "log")
  drives = drives_of(place, placed(place, [log.place, *log.parts]))
  drives.lay(place)
  text = propose(place.name, drives.tables).text if like is None else _like(like, drives.tables)
  write_text(place / FILE_NAME, text)
  return load_to_check(place)


def _like(folder: Path, tables: Sequence[Table]) -> str:
  """Another data set's dataset.toml with the recordings of these files."""
  head = (folder / FILE_NAME).read_text(encoding="utf-8").partition("[[recording]]")[0]
  recordings = [f'[[recording]]\nfile = {json.dumps(table.label)}\nrole = "identify"\n' for table in tables]
  return "\n".join([head, *recordings])


def _checked(check: LogCheck) -> dict[str, Any]:
  state = "refused" if check.of("spoils") else "beware" if check.of("beware") else "fit"
  findings = [dataclasses.asdict(f) for f in check.findings if f.severity != "note"]
  driven = round(sum(r.duration for r in check.dataset.recordings), 2)
  return {"state": state, "verdict": check.verdict, "findings": findings, "driven": driven}


def _fitted(dataset: DataSet, level: Level) -> dict[str, Any]:
  fit = calibrate(dataset, "recordings", quick=True, threads=1, progress=silent)
  shown = {name: e for name, e in fit.estimates.items() if not e.reason_not_fitted and e.identifiable}
  shown = {name: e for name, e in shown.items() if not e.at_bound and e.noise_std**2 < _SHOWN * e.prior_std**2}
  made: dict[str, Any] = {
    "parameters": {n: {"value": e.value, "std": e.noise_std, "unit": e.unit} for n, e in shown.items()}
  }
  if level == "diagnose":
    decision = diagnose(dataset, effort=NARROW, threads=1, progress=silent).diagnosis.decision
    claims = [{"mechanism": c.mechanism, "probability": c.probability} for c in decision.claims]
    made["diagnosis"] = {"verdict": decision.verdict, "claims": claims}
  return made
