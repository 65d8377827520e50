"""Every fit begins with a checked log and says what it was told, and what it leaves out."""

import pytest

from calibration.log_check import heed
from calibration.log_check.ready import ready
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from tests.calibration.log_check.test_pairs import changed, drives
from tests.qcar_twin.recordings.drives import STD, VEHICLE


def test_sensors_that_disagree_and_driving_left_out_are_said():
  runs = [changed(r, "yaw_rate", late=0.05) for r in drives(4)]
  runs[-1] = runs[-1].replace(role="holdout")
  dataset, notes = ready(DataSet("lab", tuple(runs), VEHICLE, STD), most=60.0)
  assert [r.role for r in dataset.recordings] == ["identify", "identify", "identify", "holdout"]
  late, left = notes
  assert late.startswith("yaw_rate is 55 ± ") and left.startswith("60 s of 90 s of driving are simulated, half of them")
  assert left.endswith("30 s are left out")
  assert ready(dataset, most=60.0, evenly=True)[1][-1] == (
    "60 s of 90 s of driving are simulated, spread evenly; 30 s are left out"
  )


def test_hold_out_recordings_stay_closed():
  runs = [*drives(3), *(changed(r, "yaw_rate", scale=-1.0).replace(role="holdout", name="kept") for r in drives(1))]
  assert ready(DataSet("lab", tuple(runs), VEHICLE, STD))[1] == ()
  closed = [r.replace(role="holdout") for r in drives()]
  assert heed(DataSet("lab", tuple(closed), VEHICLE, STD)) == ()


def test_a_sound_short_log_says_nothing():
  assert ready(DataSet("lab", tuple(drives()), VEHICLE, STD))[1] == ()


def test_a_log_that_contradicts_itself_is_not_fitted():
  dataset = DataSet("lab", tuple(changed(r, "yaw_rate", scale=-1.0) for r in drives()), VEHICLE, STD)
  with pytest.raises(RecordingError, match="say the contrary of turning"):
    ready(dataset)
