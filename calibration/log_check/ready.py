"""What every fit begins with: the log checked, its roles seen to, and what must be said of both."""

from calibration.fitting.coverage import with_coverage
from calibration.fitting.dataset_recalibration import LONGEST, left_out
from calibration.log_check.check import heed
from qcar_twin.recordings.dataset import DataSet


def ready(dataset: DataSet, most: float = LONGEST, evenly: bool = False) -> tuple[DataSet, tuple[str, ...]]:
  """The data set with the roles that are used, and sentences about sensors that disagree, roles, and what is left out.

  Args:
    most: s of driving that will be simulated.
    evenly: it is spread evenly; else half of it is chosen for what it tells.

  Raises:
    RecordingError: two sensors contradict each other.
  """
  checked = heed(dataset)
  dataset, joined = with_coverage(dataset)
  return dataset, (*checked, *joined, *left_out(dataset, most, evenly))
