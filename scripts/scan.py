"""Check many logs of many cars, one line of NDJSON each, and say which car or day is odd.

A data set's folder is one log, and so is any other file that can be read. The car is the first folder below the
scanned one, the day the last date in the path. A scan that was stopped goes on. Exit codes: 0, all are fit; 1, some
were refused; 2, misuse.

qcar-twin scan logs --out out/scan

qcar-twin scan logs --calibrate --out out/scan
"""

import dataclasses
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from calibration.fleet.history import write_history
from calibration.fleet.logs import find_logs
from calibration.fleet.scan import scan
from qcar_twin.atomic_io import write_json
from qcar_twin.command_line import FAILED, MISUSED, run_script
from qcar_twin.recordings.manifest import FILE_NAME
from qcar_twin.recordings.recording import RecordingError

KEPT = "logs that are done are kept; the same command goes on"


@dataclasses.dataclass(frozen=True)
class Config:
  """Check, calibrate or diagnose every log below a folder."""

  logs: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="LOGS")]]
  """Folder of the logs, those of one car in one folder below it."""
  out: Path = Path("out/scan")
  """Folder for scan.ndjson, one line a log, history.html and odd.json."""
  calibrate: bool = False
  """Also fit the twin's parameters to each log, quickly; the history then compares cars and days."""
  diagnose: bool = False
  """Also diagnose each log, quickly; includes --calibrate."""
  like: Path | None = None
  """Data set whose channels and car hold for logs without a dataset.toml; what `new` would guess where not given."""
  workers: int = 1
  """Processes; each takes one log at a time."""


def main(config: Config) -> list[dict[str, Any]]:
  """Scan, write the history, print what is refused and who is odd; ends the process with the exit code."""
  try:
    logs = find_logs(config.logs)
    if config.like is not None and not (config.like / FILE_NAME).is_file():
      raise RecordingError(f"{config.like}: holds no {FILE_NAME}; --like names the folder of a data set")
  except RecordingError as error:
    print(f"qcar-twin scan: {error}", file=sys.stderr)
    raise SystemExit(MISUSED) from error
  level = "diagnose" if config.diagnose else "calibrate" if config.calibrate else "check"

  def said(line: dict[str, Any]) -> None:
    if line["state"] == "refused":
      print(f"refused: {line['log']}: {line['verdict']}")

  lines = scan(logs, config.out / "scan.ndjson", level, config.like, config.workers, said)
  page, compared = write_history(lines, config.out / "history.html")
  write_json(config.out / "odd.json", [dataclasses.asdict(c) for c in compared])
  refused = sum(line["state"] == "refused" for line in lines)
  print(f"{len(lines)} logs, {refused} refused")
  for one in compared:
    if one.accused:
      print(f"odd: {one.sentence}")
  print(f"page: {page}")
  if refused:
    raise SystemExit(FAILED)
  return lines


if __name__ == "__main__":
  run_script()
