"""What is said of a parameter that the recordings, as they are weighed, do not move."""

from types import SimpleNamespace

import numpy as np

from calibration.fitting.optimiser import fit
from calibration.twin_calibration.estimates import HIDDEN, NOT_SHOWN, estimate_of, judged, table_of
from qcar_twin.parameters import Parameter, ParameterSet

_TWIN = SimpleNamespace(period=0.01, vehicle=SimpleNamespace(cg_height=0.05))


def _estimates(clear):
  shift = Parameter("pose_mount_x", 0.0, -0.01, 0.01, "m", "l_x", null=0.0, std=0.003, description="shifted forward")
  bias = Parameter("gyro_bias", 0.0, -0.1, 0.1, "rad/s", "b", null=0.0, std=0.01, description="bias")
  moved = np.zeros((40, 2))
  moved[:20, 0] = 10.0  # of a channel that counts by an error of 0.1 m: 3 mm move it by 0.13 in all
  fitted = fit(lambda v: v @ moved.T, ParameterSet([shift, bias]))
  rows = table_of(fitted, _TWIN, ParameterSet([shift, bias]), "not fitted", None, clear)
  return {name: estimate_of(row) for name, row in rows.items()}


def test_what_a_larger_error_hides_is_not_said_to_be_shown_by_nothing():
  noise = np.where(np.arange(40) < 20, 16.0, 1.0)  # the channel's own noise is 6 mm
  estimates = _estimates(noise)
  assert estimates["pose_mount_x"].reason_not_fitted == HIDDEN
  assert estimates["gyro_bias"].reason_not_fitted == NOT_SHOWN
  hidden = next(note for note in judged(estimates) if "hide" in note)
  assert "pose_mount_x" in hidden and "gyro_bias" not in hidden


def test_what_no_noise_would_show_is_shown_by_nothing():
  assert {e.reason_not_fitted for e in _estimates(1.0).values()} == {NOT_SHOWN}
