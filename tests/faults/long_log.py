"""What the check of a long log costs: a drive by formula, nine channels at 50 Hz, in one file.

python -m tests.faults.long_log --seconds 3600
"""

import argparse
import tempfile
import time
from pathlib import Path

from calibration.log_check.check import LogCheck, check_log, load_to_check
from tests.faults.falsities import wander, write_drive


def cost(seconds: float, folder: Path) -> tuple[float, LogCheck]:
  """Processor time of loading and checking a drive of so many seconds, s, and what the check says."""
  write_drive(folder, *wander(5, seconds=seconds), 1.0)
  begun = time.process_time()
  check = check_log(load_to_check(folder))
  return time.process_time() - begun, check


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--seconds", type=float, default=3600.0, help="Of driving.")
  config = parser.parse_args()
  with tempfile.TemporaryDirectory() as folder:
    spent, check = cost(config.seconds, Path(folder))
  print(f"{config.seconds:g} s of driving: {spent:.1f} s of processor time. {check.verdict}")


if __name__ == "__main__":
  main()
