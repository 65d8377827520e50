"""What every fit begins with: the log checked, its roles seen to, and what must be said of both."""

import dataclasses

from calibration.fitting.coverage import with_coverage
from calibration.fitting.dataset_recalibration import LONGEST, left_out
from calibration.log_check.check import heed
from qcar_twin.recordings.checks.steered import along_only, turns_unsteered
from qcar_twin.recordings.dataset import DataSet


def ready(dataset: DataSet, most: float = LONGEST, evenly: bool = False) -> tuple[DataSet, tuple[str, ...]]:
  """The data set with the roles that are used, and sentences about sensors that disagree, roles, and what is left out.

  Of a car that turned with no steering command in its log, what shows turning is left out: the twin drives straight on.

  Args:
    most: s of driving that will be simulated.
    evenly: it is spread evenly; else half of it is chosen for what it tells.

  Raises:
    RecordingError: two sensors contradict each other.
  """
  checked = heed(dataset)
  if turns_unsteered([r for r in dataset.recordings if r.role != "holdout"]):
    dataset = dataclasses.replace(dataset, recordings=tuple(along_only(dataset.recordings)))
  dataset, joined = with_coverage(dataset)
  return dataset, (*checked, *joined, *left_out(dataset, most, evenly))
