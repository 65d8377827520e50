"""Recordings as an explorer shows them: every channel on its clock, gaps where a simulation starts anew, the map."""

import numpy as np
import pytest

from calibration.shown_runs import routes_of, runs_of


@pytest.fixture(scope="module")
def observations(offset_pool):
  return offset_pool.problem.observations


def test_every_recording_is_a_run_with_commands_and_channels(observations):
  predicted = {"twin": observations.measured + 1.0}
  runs = runs_of(observations, predicted, {"twin": "the twin"}, {"yaw_rate": 0.1}, ("yaw_rate", "accel_y"))
  assert [r.name for r in runs] == list(observations.names)
  titles = [p.title for p in runs[0].panels]
  assert titles == ["motor voltage [V]", "steering command [rad]", "yaw rate [rad/s]", "lateral acceleration [m/s²]"]
  measured, twin = runs[0].panels[2].lines
  assert (measured.who, twin.label) == ("measured", "the twin") and runs[0].panels[2].noise == 0.1
  np.testing.assert_allclose(twin.value - measured.value, 1.0)
  assert twin.time is measured.time


def test_lines_break_where_the_simulation_starts_anew(observations):
  stretches = len(observations.stretches.segments)
  runs = runs_of(observations, {})
  gaps = sum(int(np.isnan(run.panels[-1].lines[0].time).sum()) for run in runs)
  assert gaps == stretches - len(runs)


def test_the_map_is_coloured_by_evidence_per_second(observations):
  evidence = np.ones(len(observations))
  routes = routes_of(observations, evidence)
  assert set(routes) == set(observations.names)
  route = routes[observations.names[0]]
  own = observations.recording == 0
  assert np.sum(route.level) * 0.2 == pytest.approx(own.sum())
  np.testing.assert_allclose(np.hypot(route.x, route.y), 1.0, atol=1e-3)  # this car drives on a circle
  assert routes_of(observations)[observations.names[0]].level is None


def test_without_a_pose_there_is_no_map(clean_pool):
  observations = clean_pool.problem.observations
  assert routes_of(observations) == {}
  assert all(run.route is None for run in runs_of(observations, {}))
