"""Check a log without a model: what spoils it, which sensors disagree, what it can show.

Writes check.json and check.html.

qcar-twin check --dataset data/sample --out out/check
"""

import dataclasses
from pathlib import Path

from calibration.log_check.check import LogCheck, check_log, load_to_check
from calibration.log_check.report import write_log_check
from calibration.progress import CHECK, StageLine
from qcar_twin.command_line import run_script


@dataclasses.dataclass(frozen=True)
class Config:
  """Timing, repeated driving, sensors of one motion against each other, and excitation; no model of a car."""

  dataset: Path
  """Folder with dataset.toml, in SI units."""
  out: Path = Path("out/check")
  """Folder for the results."""


def main(config: Config) -> LogCheck:
  """Run it, write the results, print what to know and where the page is."""
  dataset = load_to_check(config.dataset)
  with StageLine(CHECK) as progress:
    check = check_log(dataset, progress)
  page = write_log_check(check, config.out)
  print(check.verdict)
  for finding in (*check.of("spoils"), *check.of("beware")):
    print(f"{finding.severity}: {finding.text}")
  print(f"page: {page}")
  return check


if __name__ == "__main__":
  run_script()
