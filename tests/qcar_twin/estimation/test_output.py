"""Estimates as values, files and figures."""

import math

import numpy as np
import pytest

from qcar_twin.estimation import figures
from qcar_twin.estimation.estimate import no_estimate
from qcar_twin.estimation.offline import NAMES, filter_recording
from qcar_twin.estimation.output import write_estimates
from tests.qcar_twin.estimation.estimation_rig import CAR, journey, run
from tests.qcar_twin.estimation.test_offline import recording_of

TRIP = journey(4.0)
RECORDING = recording_of(TRIP)


def test_an_estimate_has_velocity_and_standard_deviations_by_name():
  estimate = run(TRIP)[0][-1]
  assert estimate.velocity_x == pytest.approx(estimate.speed * math.cos(estimate.sideslip_angle))
  assert math.hypot(estimate.velocity_x, estimate.velocity_y) == pytest.approx(abs(estimate.speed))
  assert set(estimate.std) == set(NAMES) and all(0.0 < s < 0.2 for s in estimate.std.values())
  assert estimate.std["pose_x"] == pytest.approx(math.sqrt(estimate.covariance[0]))


def test_fused_position_is_more_certain_than_either_filter():
  estimate = run(TRIP)[0][-1]
  own, other = estimate.bicycle[1][:2, :2], estimate.point[1][:2, :2]
  assert estimate.covariance[0] < min(own[0, 0], other[0, 0])
  assert estimate.covariance[2] < min(own[1, 1], other[1, 1])


def test_no_estimate_says_why_and_is_not_valid():
  estimate = no_estimate(1.5, "the reason")
  assert not estimate.valid and estimate.reasons == ("the reason",) and estimate.time == 1.5
  assert math.isnan(estimate.pose_x) and all(math.isinf(s) for s in estimate.std.values())


def test_written_estimates_can_be_read_again(tmp_path):
  estimates = filter_recording(RECORDING, CAR)
  summary = write_estimates(tmp_path, RECORDING, estimates, CAR.rolling_radius)
  rows = np.genfromtxt(tmp_path / "journey.csv", delimiter=",", names=True)
  assert rows.dtype.names[:2] == ("time", "pose_x") and len(rows) == len(estimates.time)
  np.testing.assert_allclose(rows["speed"], estimates.value["speed"], rtol=1e-6)
  np.testing.assert_allclose(rows["pose_yaw_std"], estimates.std["pose_yaw"], rtol=1e-6)
  assert summary == {"valid": 1.0, "not valid because": {}, "refused": {}}
  assert {file.name for file in tmp_path.iterdir()} == {"journey.csv", "journey_states.png", "journey_position.png"}


def test_figures_are_images_with_something_in_them(tmp_path):
  import matplotlib.image

  trip = journey(4.0)
  trip.fix[200:] = np.nan
  estimates = filter_recording(recording_of(trip), CAR)
  figures.states_figure(estimates, RECORDING, CAR.rolling_radius, tmp_path / "states.png")
  figures.error_figure(estimates.time, {"FEKF": estimates.std["pose_x"]}, "std [m]", tmp_path / "errors.png")
  for name in ("states", "errors"):
    image = matplotlib.image.imread(tmp_path / f"{name}.png")
    assert image.shape[0] > 200 and image[..., :3].std() > 0.02
  assert not list(tmp_path.glob(".writing-*"))
