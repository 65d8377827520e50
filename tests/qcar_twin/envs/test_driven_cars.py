"""The loop that training and evaluation share: what reaches the wheels, restarts, the first instant."""

import dataclasses
import math

import numpy as np
import pytest

from qcar_twin.envs.driven_cars import ESTIMATED, TRUE, Course, DrivenCars, Linkage, one_of
from qcar_twin.estimation.observer import TrueObserver
from qcar_twin.paths import path_named
from tests.qcar_twin.envs.fleet_rig import BICYCLE, Holding

COURSE = Course(path_named("infinity"), 0.5, 0.01)


def driven(count, linkage=None):
  """Bicycles at the path's start, at speed, who see the truth."""
  x, y, yaw = COURSE.path.start
  start = np.tile([x, y, yaw, COURSE.speed, 0.0, 0.0, 0.0], (count, 1))
  plant = BICYCLE.begin(np.tile(BICYCLE.parameters.nominal, (count, 1)), start)
  return DrivenCars(COURSE, plant, linkage, TrueObserver(), Holding)


def test_the_linkage_delays_lags_scales_and_offsets():
  linkage = Linkage(1, delay=0.02, lag=0.04, period=0.01, gain=0.9, offset=0.01)
  out = [float(linkage.pass_on(np.array([0.2]))[0]) for _ in range(40)]
  assert out[:2] == [0.01, 0.01]
  for k in range(2, 40):
    expected = 0.2 * (1.0 - math.exp(-(k - 1) * 0.01 / 0.04))
    assert out[k] == pytest.approx(0.9 * expected + 0.01, abs=1e-12)


def test_a_restarted_linkage_has_forgotten_what_was_under_way():
  linkage, fresh = (Linkage(2, delay=0.02, lag=0.04, period=0.01, gain=0.9) for _ in range(2))
  for _ in range(5):
    linkage.pass_on(np.array([0.2, 0.2]))
  linkage.restart(np.array([True, False]), np.array([1.1, 7.0]), np.array([0.02, 7.0]))
  for _ in range(4):
    again, expected = linkage.pass_on(np.array([0.3, 0.3])), fresh.pass_on(np.array([0.3, 0.3]))
    assert again[0] == pytest.approx(1.1 / 0.9 * expected[0] + 0.02, abs=1e-15)
    assert 0.9 * 0.3 > again[1] > expected[1]


def test_the_first_instant_is_the_start_of_the_path():
  cars = driven(2)
  assert np.abs(cars.arc_length).max() < 1e-9 and np.abs(cars.errors.cross_track).max() < 1e-12
  assert not cars.steering.any() and not cars.past.any()


def test_without_a_linkage_the_commands_reach_the_plant_as_they_are():
  plain, same = driven(2), driven(2, Linkage(2, delay=0.0, lag=0.0, period=0.01))
  for k in range(50):
    steering = 0.2 * np.sin(0.1 * k + np.arange(2))
    plain.step(steering)
    same.step(steering)
    np.testing.assert_array_equal(plain.commands[:, 1], steering)
  np.testing.assert_array_equal(plain.signals, same.signals)


def test_a_restart_leaves_the_other_cars_bit_for_bit_as_they_are():
  cars = driven(3)
  for k in range(60):
    cars.step(np.full(3, 0.1 * math.sin(0.05 * k)))
  before, arc, seen = cars.errors, cars.arc_length, cars.errors.observation.copy()
  which = np.array([False, True, False])
  cars.restart(which, 0.25, np.array([9.0, 0.7, 9.0]))
  np.testing.assert_array_equal(before.observation, seen)  # who holds the old numbers keeps them
  np.testing.assert_array_equal(cars.errors.observation[:, ~which], seen[:, ~which])
  np.testing.assert_array_equal(cars.arc_length[:, ~which], arc[:, ~which])
  assert cars.target.tolist() == [COURSE.speed, 0.7, COURSE.speed]


def test_progress_follows_truth_and_estimate_apart_and_they_agree_for_one_who_sees_the_truth():
  cars = driven(3)
  for k in range(200):
    cars.step(np.full(3, 0.1 * math.sin(0.05 * k)))
  np.testing.assert_array_equal(cars.arc_length[ESTIMATED], cars.arc_length[TRUE])
  assert cars.arc_length[TRUE] == pytest.approx(np.full(3, 200 * 0.01 * 0.5), rel=0.05)
  true = one_of(cars.errors, TRUE)
  np.testing.assert_array_equal(true.cross_track, cars.errors.cross_track[TRUE])
  assert true.observation.shape == (3, 4)


def test_a_course_of_another_speed_is_held_from_then_on():
  cars = driven(2)
  for k in range(300):
    if k == 100:
      cars.course = dataclasses.replace(cars.course, speed=np.array([0.5, 0.3]))
    cars.step(np.zeros(2))
  assert cars.target.tolist() == [0.5, 0.3]
  assert cars.speeds[TRUE] == pytest.approx([0.5, 0.3], abs=0.05)


def test_a_command_that_is_no_number_holds_the_one_before_and_spoils_no_car():
  cars, held = (driven(2, Linkage(2, delay=0.02, lag=0.04, period=0.01)) for _ in range(2))
  for k in range(40):
    right = 0.1 if k == 20 else 0.2 if k > 20 else 0.1  # what the second car is to hold for an instant
    cars.step(np.array([0.1, np.nan if k == 20 else right]))
    held.step(np.array([0.1, right]))
    assert cars.mute.tolist() == [False, k == 20]
  np.testing.assert_array_equal(cars.signals, held.signals)
  np.testing.assert_array_equal(cars.past, held.past)
  cars.step(np.array([np.inf, 0.1]))
  assert cars.mute.tolist() == [True, False] and cars.steering[0] == 0.1
  cars.restart(np.array([True, False]))
  assert not cars.mute.any() and not cars.commands[0].any() and cars.commands[1].any()
