"""Rays against geometry, scan matching against truth, and the cheap lidar against the real one's statistics."""

import mujoco
import numpy as np
import pytest

from qcar_twin.paths import path_named
from qcar_twin.sensors.base import POSE, Timing
from qcar_twin.sensors.lidar import Box, RayCaster, Room, ScanningLidar
from qcar_twin.sensors.scan_matching import ScanMatcher
from qcar_twin.sensors.statistical_lidar import StatisticalLidar
from qcar_twin.sensors.suite import SensorSuite

TRACK = path_named("infinity")
ROOM = Room.around(TRACK.x, TRACK.y)
PLAIN = Room((Box(0.0, -2.0, 3.0, 0.1), Box(0.0, 2.0, 3.0, 0.1), Box(-3.0, 0.0, 0.1, 2.0), Box(3.0, 0.0, 0.1, 2.0)))


def by_hand(segments, pose, angles):
  """Ranges by intersecting every ray with every segment."""
  out = []
  for angle in pose[2] + angles:
    direction = np.array([np.cos(angle), np.sin(angle)])
    best = np.inf
    for x1, y1, x2, y2 in segments:
      along = np.array([x2 - x1, y2 - y1])
      system = np.column_stack([direction, -along])
      if abs(np.linalg.det(system)) < 1e-12:
        continue
      t, u = np.linalg.solve(system, np.array([x1, y1]) - pose[:2])
      if t > 0.0 and 0.0 <= u <= 1.0:
        best = min(best, t)
    out.append(best)
  return np.array(out)


def test_rays_hit_where_geometry_says():
  caster = RayCaster(ROOM, beams=60)
  for pose in ([0.3, 0.2, 0.4], [-1.0, 0.5, -2.0]):
    expected = by_hand(ROOM.segments(), np.array(pose), caster.angles)
    np.testing.assert_allclose(caster.cast(*pose), expected, atol=1e-6)


def test_beyond_reach_nothing_comes_back():
  ranges = RayCaster(PLAIN, beams=4, reach=2.5).cast(0.0, 0.0, 0.0)
  assert np.isnan(ranges[[0, 2]]).all() and ranges[[1, 3]] == pytest.approx(1.9, abs=1e-9)


def test_a_turned_car_sees_the_room_turned():
  caster = RayCaster(ROOM, beams=360)
  np.testing.assert_allclose(
    caster.cast(0.1, 0.2, np.radians(30.0)), np.roll(caster.cast(0.1, 0.2, 0.0), -30), atol=1e-6
  )


def test_room_leaves_the_track_free_and_has_no_symmetry():
  corners = ROOM.segments()[:, :2]
  assert np.hypot(corners[:, None, 0] - TRACK.x, corners[:, None, 1] - TRACK.y).min() > 0.4
  assert len(ROOM.boxes) == 12
  caster = RayCaster(ROOM, beams=120)
  here = caster.cast(0.0, 0.0, 0.0)
  assert min(np.abs(here - np.roll(here, shift)).mean() for shift in range(1, 120)) > 0.02


def test_walls_can_be_put_into_any_model():
  spec = mujoco.MjSpec()
  ROOM.add_to(spec)
  model = spec.compile()
  assert model.ngeom == 12 and model.geom("wall_3").id == 3


def test_survey_moves_every_box_a_little():
  surveyed = ROOM.surveyed(0.01, np.random.default_rng(0))
  moved = np.array([(a.x - b.x, a.y - b.y) for a, b in zip(surveyed.boxes, ROOM.boxes, strict=True)])
  assert 0.004 < moved.std() < 0.02 and np.all(moved != 0.0)


# -- scan matching -------------------------------------------------------------------------------


def matcher_and_scan(pose, noise=0.0, seed=0, room=ROOM):
  caster = RayCaster(room)
  ranges = caster.cast(*pose) + noise * np.random.default_rng(seed).normal(size=len(caster.angles))
  return ScanMatcher(room.segments(), caster.angles), ranges


@pytest.mark.parametrize("offset", [(0.05, -0.05, 0.05), (-0.1, 0.08, -0.1), (0.15, 0.15, 0.1)])
def test_a_perfect_scan_gives_the_exact_pose(offset):
  pose = np.array([0.4, -0.3, 0.7])
  matcher, ranges = matcher_and_scan(pose)
  match = matcher.match(ranges, pose + offset)
  np.testing.assert_allclose(match.pose, pose, atol=2e-5)
  assert match.score > 99.0 and match.rms < 1e-4


def test_errors_shrink_like_the_range_noise():
  pose = np.array([0.4, -0.3, 0.7])
  spread = []
  for noise in (0.005, 0.02):
    errors = [matcher_and_scan(pose, noise, seed) for seed in range(15)]
    errors = [matcher.match(ranges, pose + 0.02).pose - pose for matcher, ranges in errors]
    spread.append(np.std(errors, axis=0))
  assert np.all(spread[0] < (0.002, 0.002, 0.001))
  assert np.all(spread[1] / spread[0] > 2.0)


def test_people_in_the_way_do_not_pull_the_pose():
  pose = np.array([0.4, -0.3, 0.7])
  matcher, ranges = matcher_and_scan(pose, 0.01)
  ranges[100:160] = np.minimum(ranges[100:160], 0.6)  # something the map does not know
  match = matcher.match(ranges, pose + (0.03, -0.02, 0.02))
  np.testing.assert_allclose(match.pose, pose, atol=5e-3)
  assert 55.0 < match.score < 90.0


def test_score_falls_with_range_noise():
  pose = np.array([0.4, -0.3, 0.7])
  scores = [
    matcher.match(ranges, pose).score for matcher, ranges in (matcher_and_scan(pose, n) for n in (0.0, 0.01, 0.03))
  ]
  assert scores[0] > scores[1] > scores[2]


def test_a_pose_half_a_metre_off_is_searched_for():
  pose = np.array([0.4, -0.3, 0.7])
  matcher, ranges = matcher_and_scan(pose, 0.01)
  match = matcher.match(ranges, pose + (0.5, -0.4, 0.3))
  np.testing.assert_allclose(match.pose, pose, atol=5e-3)


def test_yaw_is_unwrapped_towards_the_guess():
  pose = np.array([0.4, -0.3, 0.7])
  matcher, ranges = matcher_and_scan(pose)
  assert matcher.match(ranges, pose + (0.0, 0.0, 4 * np.pi)).pose[2] == pytest.approx(0.7 + 4 * np.pi, abs=1e-4)


def test_an_empty_scan_has_no_score_and_keeps_the_guess():
  matcher, ranges = matcher_and_scan(np.zeros(3))
  match = matcher.match(np.full_like(ranges, np.nan), np.array([1.0, 2.0, 3.0]))
  assert match.score == 0.0 and match.pose.tolist() == [1.0, 2.0, 3.0]


def test_a_map_with_a_point_in_it_is_refused():
  with pytest.raises(ValueError, match="segment 1 of the map has no length"):
    ScanMatcher(np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 1.0, 1.0, 1.0]]), np.zeros(3))


# -- the sensor ----------------------------------------------------------------------------------


def lap(lidar, laps=1):
  """Errors and scores along the track at 0.5 m/s, one fix per 5 cm."""
  suite = SensorSuite({"lidar": lidar}, 1, 0, period=0.1)
  point = TRACK.at(np.arange(0.0, laps * TRACK.length, 0.05))
  rows = []
  for x, y, yaw in zip(point.x, point.y, point.yaw, strict=True):
    now = np.zeros((1, 10))
    now[0, POSE] = x, y, yaw
    rows.append(suite.measure(now)[0].values[0] - (x, y, yaw, 0.0))
  return np.array(rows)


def test_scanning_lidar_follows_a_lap_within_a_centimetre_and_a_half():
  rows = lap(ScanningLidar(ROOM, Timing(10.0, 0.0, 0.0)))
  assert np.abs(rows[:, :2]).max() < 0.015 and np.abs(rows[:, 2]).max() < 0.006
  assert rows[:, 3].min() > 60.0


def test_a_perfect_map_is_better_than_a_surveyed_one():
  timing = Timing(10.0, 0.0, 0.0)
  good, surveyed = (lap(ScanningLidar(ROOM, timing, map_std=std)) for std in (0.0, 0.02))
  assert np.sqrt(np.mean(good[:, :2] ** 2)) < 0.4 * np.sqrt(np.mean(surveyed[:, :2] ** 2))


def test_the_cheap_lidar_has_the_statistics_of_the_scanning_one():
  timing = Timing(10.0, 0.0, 0.0)
  rows = lap(ScanningLidar(ROOM, timing, map_std=0.01), laps=2)
  cheap = StatisticalLidar.from_errors(rows[:, :3] - rows[:, :3].mean(axis=0), rows[:, 3], timing)
  again = lap(cheap, laps=8)
  wanted = np.sqrt(np.mean(np.var(rows[:, :2], axis=0)))
  assert np.sqrt(np.mean(np.var(again[:, :2], axis=0))) == pytest.approx(wanted, rel=0.35)
  assert np.std(again[:, 2]) == pytest.approx(np.std(rows[:, 2]), rel=0.5)
  assert np.median(again[:, 3]) == pytest.approx(np.median(rows[:, 3]), rel=0.03)


def test_lidar_poses_of_a_lost_car_restart_with_the_run():
  lidar = ScanningLidar(ROOM, Timing(10.0, 0.0, 0.0))
  suite = SensorSuite({"lidar": lidar}, 1, 0, period=0.1)
  now = np.zeros((1, 10))
  suite.measure(now)
  now[0, POSE] = 1.5, 0.3, 2.0
  suite.restart(np.array([True]), now)
  np.testing.assert_allclose(suite.measure(now)[0].values[0, :3], (1.5, 0.3, 2.0), atol=0.02)
