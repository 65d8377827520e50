"""Check a log without a model: its faults, which sensors disagree, what it can show.

Writes check.json and check.html.

qcar-twin check --dataset data/sample --out out/check
"""

import dataclasses
from pathlib import Path

from calibration.log_check.check import LogCheck
from calibration.log_check.report import check_and_say
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
  return check_and_say(config.dataset, config.out)


if __name__ == "__main__":
  run_script()
