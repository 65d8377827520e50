"""Calibration and diagnosis start from one and the same recalibrated twin."""

import numpy as np
import pytest

from calibration.diagnosis.pipeline import prepare
from calibration.twin_calibration.calibration import calibrate
from qcar_twin.recordings.dataset import DataSet
from tests.scripts import tiny_session


@pytest.fixture(scope="module")
def tiny(tmp_path_factory) -> DataSet:
  return tiny_session.write(tmp_path_factory.mktemp("data") / "tiny")


@pytest.fixture(scope="module")
def begun(tiny):
  return prepare(tiny, threads=1)


def test_a_calibration_is_the_twin_a_diagnosis_starts_from(tiny, begun):
  """Mechanisms at their null change no bit, so it does not matter that the diagnosis carries the whole catalogue."""
  calibration = calibrate(tiny, "recordings", threads=1)
  names = begun.recalibrated.fit.parameters.names
  fitted = dict(zip(names, begun.recalibrated.fit.theta, strict=True))
  for name, estimate in calibration.estimates.items():
    if not estimate.reason_not_fitted:
      assert estimate.value == pytest.approx(fitted[name], rel=1e-12, abs=1e-15), name
  assert calibration.command_shift == begun.recalibrated.command_shift


def test_where_the_twin_is_recalibrated_already_nothing_is_fitted(tiny, begun, monkeypatch):
  monkeypatch.setattr("calibration.twin_calibration.calibration.recalibrate_dataset", None)
  calibration = calibrate(tiny, "recordings", threads=1, recalibrated=lambda: begun.recalibrated)
  assert np.all(np.isfinite(calibration.theta)) and len(calibration.errors["identify"])
