"""Estimates as values, files and figures."""

import json
import math

import numpy as np
import pytest

from qcar_twin.estimation.estimate import no_estimate
from qcar_twin.estimation.offline import NAMES, filter_recording
from qcar_twin.estimation.page import sections, write_all, write_estimates, write_estimation
from qcar_twin.estimation.settings import ESTIMATED, FilterSettings
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
  summary = write_estimates(tmp_path, RECORDING, estimates)
  rows = np.genfromtxt(tmp_path / "journey.csv", delimiter=",", names=True)
  assert rows.dtype.names[:2] == ("time", "pose_x") and len(rows) == len(estimates.time)
  np.testing.assert_allclose(rows["speed"], estimates.value["speed"], rtol=1e-6)
  np.testing.assert_allclose(rows["pose_yaw_std"], estimates.std["pose_yaw"], rtol=1e-6)
  assert summary == {"valid": 1.0, "not valid because": {}, "refused": {}}
  assert {file.name for file in tmp_path.iterdir()} == {"journey.csv"}


@pytest.mark.parametrize("origin", [(1759663727.0, 0.0, 0.0), (0.0, 5e5, 5.4e6), (86400.125, -2e4, 3.0)])
def test_estimates_are_on_the_logs_own_clock_and_in_its_frame_to_the_last_bit(tmp_path, origin):
  estimates = filter_recording(RECORDING, CAR)
  write_estimates(tmp_path, RECORDING.replace(origin=origin), estimates)
  rows = np.genfromtxt(tmp_path / "journey.csv", delimiter=",", names=True)
  assert len(np.unique(rows["time"])) == len(estimates.time)
  assert (rows["time"] == estimates.time + origin[0]).all() and (rows["speed"] == estimates.value["speed"]).all()
  known = np.isfinite(estimates.value["pose_x"])
  assert (rows["pose_x"] == estimates.value["pose_x"] + origin[1])[known].all()


def test_the_page_shows_bands_about_what_was_measured_and_when_it_is_not_valid(tmp_path):
  trip = journey(4.0)
  trip.fix[200:] = np.nan
  recording = recording_of(trip)
  estimates = filter_recording(recording, CAR)
  explorer = sections([(recording, estimates)], CAR.rolling_radius)[0].figures[0]
  run = explorer.runs[0]
  assert [p.title.split(" [")[0] for p in run.panels] == ["x", "y", "yaw", "speed", "sideslip", "yaw rate"]
  measured, estimate = run.panels[3].lines
  assert (measured.who, measured.dots) == (
    "measured",
    True,
  ) and measured.value.max() < 5.0  # m/s
  known = np.isfinite(estimate.spread)
  np.testing.assert_allclose(estimate.spread[known], 2.0 * estimates.std["speed"][known])
  silent = np.flatnonzero(~estimates.valid)
  if len(silent):
    assert run.shaded[0][0] <= estimates.time[silent[0]] and len(explorer.moments) == len(run.shaded)
  page = write_estimation(tmp_path, [(recording, estimates)], CAR.rolling_radius, "trip")
  assert f"valid for {100.0 * estimates.valid.mean():.1f} %" in page.read_text(encoding="utf-8")


def test_estimated_numbers_are_in_every_file(tmp_path):
  estimates = filter_recording(RECORDING, CAR, FilterSettings().estimating(*ESTIMATED))
  assert set(estimates.numbers) == set(ESTIMATED)
  write_all(tmp_path, [(RECORDING, estimates)])
  said = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))[RECORDING.name]["numbers"]
  gain = estimates.numbers["steering_gain"]
  assert said["steering_gain"] == {"value": gain[-1, 0], "std": gain[-1, 1]} and gain[-1, 0] == pytest.approx(
    1.0, abs=0.2
  )
  head = (tmp_path / f"{RECORDING.name}.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
  assert {"speed_scale", "speed_scale_std"} <= set(head)
  tables = sections([(RECORDING, estimates)], 0.003)[-1].tables
  (table,) = [table for table in tables if table.caption.startswith("Estimated parameters")]
  assert [row[1] for row in table.rows] == list(estimates.numbers)
