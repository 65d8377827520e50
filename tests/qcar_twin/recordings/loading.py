"""Data sets that must be refused, or loaded with a warning."""

import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.recordings.drives import folder_with


def refused(folder, *texts):
  """Loading fails with a text that holds all of `texts`."""
  with pytest.raises(RecordingError) as caught:
    DataSet.load(folder)
  for text in texts:
    assert text in str(caught.value)
  return caught.value


def refused_run(tmp_path, time, columns, *texts, **manifest):
  with pytest.raises(RecordingError) as caught:
    DataSet.load(folder_with(tmp_path, time, columns, **manifest))
  for text in ("run.csv: ", *texts):
    assert text in str(caught.value)


def warned(tmp_path, time, columns, **manifest):
  return DataSet.load(folder_with(tmp_path, time, columns, **manifest)).warnings
