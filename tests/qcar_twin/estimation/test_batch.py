"""N cars side by side against as many told sample by sample: gates, dropouts, late fixes, lost cars, restarts."""

import math

import numpy as np
import pytest

from qcar_twin.estimation import models
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.settings import FilterSettings
from tests.qcar_twin.estimation.estimation_rig import CAR, PERIOD, hold

CARS = 4
HARD = FilterSettings(
  sharing=(0.5, 0.5), steering_lag=0.03, imu_x=0.02, imu_y=-0.01, yaw_rate_bias=0.01, accel_x_bias=0.1
)


def story(steps, latency, seed=0):
  """Motion, accelerations and late fixes with everything that can go wrong, per period."""
  rng = np.random.default_rng(seed)
  state = np.stack([np.zeros(CARS), np.zeros(CARS), np.full(CARS, 0.5), 0.1 * np.arange(CARS)], axis=1)
  state = np.concatenate([state, np.zeros((CARS, 2))], axis=1)
  waiting = {}
  for k in range(1, steps):
    voltage = hold(0.5) if k < 0.7 * steps else hold(-0.3)
    commands = np.stack([np.full(CARS, voltage), 0.2 * np.sin(PERIOD * k + np.arange(CARS))], axis=1)
    state = np.stack(models.bicycle_step(tuple(state.T), *commands.T, CAR, PERIOD, np)[0], axis=1)
    motion = state[:, [2, 5]] + rng.normal(size=(CARS, 2)) * (0.01, 0.02)
    motion[rng.random((CARS, 2)) < 0.05] = np.nan
    motion[rng.random((CARS, 2)) < 0.01] += 3.0
    accel = 0.2 * rng.normal(size=(CARS, 2)) + np.stack([0 * state[:, 2], state[:, 2] * state[:, 5]], axis=1)
    if 200 < k < 260:
      accel[1] = np.nan
    if k % 10 == 0:
      fix = np.concatenate([state[:, [0, 1, 3]] + 0.008 * rng.normal(size=(CARS, 3)), rng.uniform(0, 99, (CARS, 1))], 1)
      fix[rng.random(CARS) < 0.1] = np.nan
      fix[rng.random(CARS) < 0.05, 0] += 0.5
      fix[2, :2] += 1.0 * (k > 500)  # carried elsewhere
      fix[0, 3] = np.nan if k % 30 == 0 else fix[0, 3]  # a fix without score
      waiting[k + latency] = fix
    yield k, commands, motion, accel, waiting.pop(k, None)


def tell(federated, i, k, motion, accel, fix, latency):
  stamp = k * PERIOD
  for name, value in zip(("speed", "yaw_rate", "accel_x", "accel_y"), (*motion[i], *accel[i]), strict=True):
    if math.isfinite(value):
      federated.update(stamp, name, value)
  if fix is not None and math.isfinite(fix[i, 0]):
    for name, value in zip(("pose_x", "pose_y", "pose_yaw", "pose_score"), fix[i], strict=True):
      if math.isfinite(value):
        federated.update(stamp - latency * PERIOD, name, value)


@pytest.mark.parametrize(("latency", "settings"), [(0, FilterSettings()), (5, HARD), (9, HARD)])
def test_many_cars_at_once_are_as_many_told_sample_by_sample(latency, settings):
  online = [FederatedFilter(CAR, settings) for _ in range(CARS)]
  batch = FederatedBatch(CAR, settings, CARS, watched=True)
  pose = np.stack([np.zeros(CARS), np.zeros(CARS), 0.1 * np.arange(CARS)], axis=1)
  batch.start(pose, np.full(CARS, 0.5))
  for i, federated in enumerate(online):
    federated.start(0.0, tuple(pose[i]), 0.5)
  worst = 0.0
  for k, commands, motion, accel, fix in story(900, latency):
    batch.command(commands)
    batch.advance(motion, accel, fix, latency)
    estimate = batch.estimate()
    for i, federated in enumerate(online):
      federated.update((k - 1) * PERIOD, "motor_voltage", commands[i, 0])
      federated.update((k - 1) * PERIOD, "steering_command", commands[i, 1])
      tell(federated, i, k, motion, accel, fix, latency)
      one = federated.estimate(k * PERIOD)
      mine = [
        *estimate.pose[i],
        estimate.speed[i],
        estimate.sideslip_angle[i],
        estimate.yaw_rate[i],
        *estimate.covariance[i],
      ]
      other = [one.pose_x, one.pose_y, one.pose_yaw, one.speed, one.sideslip_angle, one.yaw_rate, *one.covariance]
      worst = max(worst, float(np.abs(np.subtract(mine, other)).max()))
      assert one.valid == estimate.valid[i], (k, i, one.reasons)
      assert estimate.velocity[i] == pytest.approx((one.velocity_x, one.velocity_y), abs=1e-9)
  assert worst < 1e-9
  assert sum(f.refused["pose", "gate"] for f in online) > 10
  assert online[2].refused["pose", "gate"] >= settings.lost_after


def test_a_restarted_car_is_a_fresh_one_and_the_others_do_not_notice():
  latency = 5
  pose = np.stack([np.zeros(CARS), np.zeros(CARS), 0.1 * np.arange(CARS)], axis=1)
  again, untouched = (FederatedBatch(CAR, HARD, CARS) for _ in range(2))
  fresh = FederatedFilter(CAR, HARD, watched=False)
  for batch in (again, untouched):
    batch.start(pose, np.full(CARS, 0.5))
  which = np.array([False, True, False, False])
  at = 103  # a fix of period 100 is still on its way
  for k, commands, motion, accel, fix in story(200, latency):
    for batch in (again, untouched):
      batch.command(commands)
      batch.advance(motion, accel, fix, latency)
    if k == at:
      again.start(pose + 0.5, np.full(CARS, 0.2), which=which)
      fresh.start(k * PERIOD, tuple(pose[1] + 0.5), 0.2)
    elif k > at:
      fresh.update((k - 1) * PERIOD, "motor_voltage", commands[1, 0])
      fresh.update((k - 1) * PERIOD, "steering_command", commands[1, 1])
      tell(fresh, 1, k, motion, accel, fix, latency)
      one = fresh.estimate(k * PERIOD)
      assert again.estimate().pose[1] == pytest.approx((one.pose_x, one.pose_y, one.pose_yaw), abs=1e-9), k
    others = ~which
    np.testing.assert_array_equal(again.state.bicycle[others], untouched.state.bicycle[others])
    np.testing.assert_array_equal(again.state.point_covariance[others], untouched.state.point_covariance[others])


def test_one_car_is_the_same_alone_and_in_company():
  together, alone = FederatedBatch(CAR, HARD, CARS), FederatedBatch(CAR, HARD, 1)
  together.start(np.zeros((CARS, 3)), np.full(CARS, 0.5))
  alone.start(np.zeros((1, 3)), np.full(1, 0.5))
  for _, commands, motion, accel, fix in story(150, 2):
    together.command(commands)
    together.advance(motion, accel, fix, 2)
    alone.command(commands[3:])
    alone.advance(motion[3:], accel[3:], None if fix is None else fix[3:], 2)
  np.testing.assert_allclose(together.state.bicycle[3], alone.state.bicycle[0], rtol=0, atol=1e-13)


def test_fix_older_than_kept_is_an_error():
  batch = FederatedBatch(CAR, FilterSettings(), 1, oldest=3)
  with pytest.raises(ValueError, match="raise `oldest`"):
    batch.advance(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 4)), age=4)


def test_the_oldest_fix_that_may_arrive_is_used():
  """A buffer that just reaches back far enough is as good as a long one."""
  short, long = (FederatedBatch(CAR, FilterSettings(), 2, oldest=oldest) for oldest in (3, 50))
  motion, accel, fix = np.tile([0.5, 0.0], (2, 1)), np.zeros((2, 2)), np.tile([0.05, 0.02, 0.01, 80.0], (2, 1))
  for batch in (short, long):
    batch.start(np.zeros((2, 3)), np.full(2, 0.5))
    for k in range(1, 30):
      batch.command(np.tile([hold(0.5), 0.0], (2, 1)))
      batch.advance(motion, accel, fix + (0.005 * (k - 10), 0.0, 0.0, 0.0) if k % 6 == 0 else None, age=3)
  np.testing.assert_array_equal(short.state.bicycle, long.state.bicycle)
  assert np.isfinite(short.nis).all() and short.state.bicycle[0, 1] > 1e-3


def test_not_a_number_never_spreads():
  batch = FederatedBatch(CAR, FilterSettings(), 3)
  batch.start(np.zeros((3, 3)), np.full(3, 0.5))
  nothing = np.full((3, 2), np.nan)
  for k in range(100):
    batch.command(np.tile([hold(0.5), 0.1], (3, 1)))
    bad = np.array([[np.nan, np.inf], [-np.inf, np.nan], [0.5, 0.2]])
    batch.advance(bad, nothing if k % 2 else np.full((3, 2), np.inf), np.full((3, 4), np.nan) if k % 10 == 0 else None)
  estimate = batch.estimate()
  assert np.isfinite(estimate.pose).all() and np.isfinite(estimate.covariance).all()
