"""Paths: integration against closed forms, closure, continuity, projection, borders."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qcar_twin import paths
from qcar_twin.paths import PATHS, path_from_pieces, path_named, turn

ALL = {name: path_named(name) for name in PATHS}


def pose_beside(path, arc, across, heading=0.0):
  point = path.at(np.asarray(arc, dtype=float))
  return np.stack(
    [point.x - across * np.sin(point.yaw), point.y + across * np.cos(point.yaw), point.yaw + heading], axis=-1
  )


@pytest.mark.parametrize("curvature", [-2.0, -0.3, 0.5, 1.7])
def test_arc_is_a_circle(curvature):
  path = path_from_pieces("arc", [(3.0, curvature, curvature)], start=(0.3, -0.2, 0.4))
  yaw = 0.4 + curvature * path.arc_length
  np.testing.assert_allclose(path.x, 0.3 + (np.sin(yaw) - np.sin(0.4)) / curvature, atol=1e-13)
  np.testing.assert_allclose(path.y, -0.2 - (np.cos(yaw) - np.cos(0.4)) / curvature, atol=1e-13)


def test_clothoid_is_the_fresnel_integral():
  from scipy.special import fresnel

  path = path_from_pieces("clothoid", [(1.0, 0.0, np.pi)])  # yaw = pi s^2 / 2
  sine, cosine = fresnel(path.arc_length)
  np.testing.assert_allclose(path.x, cosine, atol=1e-13)
  np.testing.assert_allclose(path.y, sine, atol=1e-13)


@pytest.mark.parametrize("name", PATHS)
def test_stored_quantities_are_derivatives_of_each_other(name):
  path = ALL[name]
  s = np.linspace(0.0, path.length, 2311)[1:-1]
  h = 1e-3
  ahead, behind, here = path.at(s + h), path.at(s - h), path.at(s)
  np.testing.assert_allclose((ahead.x - behind.x) / (2 * h), np.cos(here.yaw), atol=2e-5)
  np.testing.assert_allclose((ahead.y - behind.y) / (2 * h), np.sin(here.yaw), atol=2e-5)
  np.testing.assert_allclose((ahead.yaw - behind.yaw) / (2 * h), here.curvature, atol=1.5e-2)
  assert np.max(np.abs(np.diff(path.curvature))) < 0.1  # no jump: at most 0.1 1/m in 5 mm


@pytest.mark.parametrize("name", ["o", "infinity"])
def test_closed_paths_close(name):
  path = ALL[name]
  assert np.hypot(path.x[-1] - path.x[0], path.y[-1] - path.y[0]) < 1e-9
  assert path.curvature[-1] == pytest.approx(path.curvature[0], abs=1e-12)
  turns = (path.yaw[-1] - path.yaw[0]) / (2 * np.pi)
  assert turns == pytest.approx({"o": 1.0, "infinity": 0.0}[name], abs=1e-12)
  here, next_lap = path.at(1.234), path.at(1.234 + path.length)
  assert (next_lap.x, next_lap.y) == pytest.approx((here.x, here.y), abs=1e-9)
  assert next_lap.yaw - here.yaw == pytest.approx(2 * np.pi * turns, abs=1e-12)


def test_infinity_is_nowhere_tighter_than_the_training_path():
  assert np.abs(ALL["infinity"].curvature).max() <= np.abs(ALL["s"].curvature).max()


def test_every_path_can_be_steered():
  """Kinematic steering for the tightest curvature leaves 2 degrees to the QCar's lock."""
  for path in ALL.values():
    assert np.arctan(0.256 * np.abs(path.curvature).max()) < 0.5236 - np.radians(2.0)


def test_infinity_crosses_itself_at_the_origin():
  path = ALL["infinity"]
  middle = path.at(path.length / 2)
  assert (float(middle.x), float(middle.y)) == pytest.approx((0.0, 0.0), abs=1e-9)
  assert np.ptp(path.x) > 2 * np.ptp(path.y)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(PATHS)), st.floats(0.02, 0.98), st.floats(-0.3, 0.3))
def test_projection_finds_the_foot_point(name, share, across):
  path = ALL[name]
  arc = share * path.length
  pose = pose_beside(path, arc, across)
  foot = float(path.nearest(pose[0], pose[1], near=arc + 0.1))
  assert foot == pytest.approx(arc, abs=1e-6)
  errors = path.errors(foot, pose, np.array([0.5, 0.0]), 0.0)
  assert float(errors.cross_track) == pytest.approx(across, abs=1e-7)
  assert abs(float(errors.heading)) < 1e-6


def test_projection_without_a_hint_searches_the_whole_path():
  path = ALL["c"]
  arcs = np.linspace(0.1, path.length - 0.1, 40)
  poses = pose_beside(path, arcs, 0.05)
  np.testing.assert_allclose(path.nearest(poses[:, 0], poses[:, 1]), arcs, atol=1e-6)


def test_projection_keeps_to_its_branch_at_the_crossing():
  path = ALL["infinity"]
  for arc in (0.02, path.length / 2 + 0.02):
    pose = pose_beside(path, arc, 0.01)
    assert float(path.nearest(pose[0], pose[1], near=arc - 0.05)) == pytest.approx(arc, abs=1e-6)


def test_travelled_distance_by_the_papers_integral_equals_the_projection():
  """A car driving 4 cm beside the path: integrating ds/dt stays on the foot point (errors of the step only)."""
  path, period, speed, across = ALL["o"], 0.01, 0.5, 0.04
  arc, s = 0.0, 0.0
  for _ in range(1400):
    pose = pose_beside(path, s, across)
    rate = path.at(s).curvature
    errors = path.errors(arc, pose, np.array([speed, 0.0]), 0.0)
    arc += period * float(errors.arc_rate)
    s += period * speed / (1.0 - float(rate) * across)
  assert arc == pytest.approx(s, abs=2e-3)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.1, 6.0), st.floats(-0.1, 0.1), st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.floats(-2.0, 2.0))
def test_error_rates_are_the_derivatives_of_the_errors(arc, across, heading, sideways, yaw_rate):
  path, h = ALL["s"], 1e-6
  pose = pose_beside(path, arc, across, heading)
  velocity = np.array([0.5, sideways])
  errors = path.errors(arc, pose, velocity, yaw_rate)
  cos, sin = np.cos(pose[2]), np.sin(pose[2])
  moved = pose + h * np.array([0.5 * cos - sideways * sin, 0.5 * sin + sideways * cos, yaw_rate])
  after = path.errors(arc + h * float(errors.arc_rate), moved, velocity, yaw_rate)
  assert float(after.cross_track - errors.cross_track) / h == pytest.approx(float(errors.cross_track_rate), abs=1e-4)
  assert float(after.heading - errors.heading) / h == pytest.approx(float(errors.heading_rate), abs=1e-3)


def test_errors_are_positive_to_the_left():
  path = path_from_pieces("line", [(5.0, 0.0, 0.0)])
  errors = path.errors(1.0, np.array([1.0, 0.2, 0.1]), np.array([0.5, 0.0]), 0.3)
  assert errors.observation == pytest.approx([0.2, 0.5 * np.sin(0.1), 0.1, 0.3])


def test_an_open_path_goes_on_straight():
  path = ALL["s"]
  beyond = path.at(path.length + 0.3)
  assert float(beyond.curvature) == 0.0
  assert float(beyond.x) == pytest.approx(path.x[-1] + 0.3 * np.cos(path.yaw[-1]), abs=1e-9)


def test_double_lane_change_has_the_scaled_iso_dimensions():
  first, second, third = ALL["c"].lanes
  assert [lane.end - lane.start for lane in (first, second, third)] == pytest.approx([1.2, 1.1, 1.2], abs=1e-12)
  assert (second.start - first.end, third.start - second.end) == pytest.approx((1.35, 1.25), abs=1e-12)
  widths = [lane.left - lane.right for lane in (first, second, third)]
  assert widths == pytest.approx([0.234, 0.29, 0.3], abs=1e-12)
  assert second.right - first.left == pytest.approx(0.1, abs=1e-12)
  assert third.right == pytest.approx(first.right, abs=1e-12)


def test_reference_passes_the_lanes_and_22_mm_is_the_clearance_of_the_first():
  path = ALL["c"]
  assert path.inside_lanes(path.x, path.y, path.yaw).all()
  lane = path.lanes[0]
  middle = 0.5 * (lane.start + lane.end)
  at = float(path.nearest(middle, 0.5 * (lane.left + lane.right)))
  for across, expected in ((0.0219, True), (0.0221, False), (-0.0219, True), (-0.0221, False)):
    pose = pose_beside(path, at, across)
    assert bool(path.inside_lanes(*pose)) is expected


def test_a_yawed_car_touches_with_its_corner():
  path = ALL["c"]
  lane = path.lanes[1]
  x, y = 0.5 * (lane.start + lane.end), 0.5 * (lane.left + lane.right)
  assert bool(path.inside_lanes(np.array(x), np.array(y), np.array(0.1)))
  assert not bool(path.inside_lanes(np.array(x), np.array(y), np.array(0.4)))


def test_jump_of_curvature_is_refused():
  with pytest.raises(ValueError, match="put a clothoid between"):
    path_from_pieces("bad", [(1.0, 0.0, 0.0), (1.0, 1.0, 1.0)])


def test_a_turn_too_short_for_its_transitions_is_refused():
  with pytest.raises(ValueError, match="too short"):
    path_from_pieces("bad", turn(0.2, 1.0, 0.5))


def test_unknown_path_names_the_nearest():
  with pytest.raises(KeyError, match="did you mean infinity"):
    path_named("infinty")


def test_paths_cannot_be_written_into():
  with pytest.raises(ValueError):
    ALL["o"].x[0] = 1.0


def test_lane_change_meets_advance_and_offset_exactly():
  path = path_from_pieces("change", paths.lane_change(1.35, 0.362))
  assert (path.x[-1], path.y[-1], path.yaw[-1]) == pytest.approx((1.35, 0.362, 0.0), abs=1e-10)
