"""A data set loaded, checked and reported on: what `new`, `look` and `check` all print and write."""

from pathlib import Path

from calibration.log_check.check import LogCheck, check_log, load_to_check
from calibration.log_check.report import write_log_check
from calibration.progress import CHECK, StageLine


def check_and_say(folder: Path, out: Path) -> LogCheck:
  """Check the data set in `folder`, write the page into `out`, print the verdict, what to know, and where the page is.

  Raises:
    RecordingError: the data set cannot be loaded.
  """
  dataset = load_to_check(folder)
  with StageLine(CHECK) as progress:
    check = check_log(dataset, progress)
  page = write_log_check(check, out)
  print(check.verdict)
  for finding in (*check.of("spoils"), *check.of("beware")):
    print(f"{finding.severity}: {finding.text}")
  print(f"page: {page}")
  return check
