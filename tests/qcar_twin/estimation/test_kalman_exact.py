"""Reductions to known things: filterpy's extended Kalman filter step by step, the textbook, the information fusion."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qcar_twin.estimation import kalman, models
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.master import fuse_positions
from qcar_twin.estimation.settings import FilterSettings
from tests.qcar_twin.estimation.estimation_rig import CAR, PERIOD, journey
from tests.qcar_twin.estimation.filterpy_reference import Extended, Reference, fuse

HARD = FilterSettings(
  sharing=(0.4, 0.6),
  steering_lag=0.03,
  imu_x=0.02,
  imu_y=-0.01,
  yaw_rate_bias=0.01,
  accel_x_bias=0.1,
  front_drive_share=0.5,
  lidar_correlation=0.3,
)
F = np.array([[1.0, 0.1], [-0.2, 0.95]])
Q = np.array([[0.02, 0.005], [0.005, 0.03]])
R = 0.4


# -- one correction, one prediction --------------------------------------------------------------


def test_on_a_linear_model_it_is_the_kalman_filter_of_the_textbook():
  rng = np.random.default_rng(0)
  x, p = np.array([1.0, -1.0]), np.eye(2)
  state, covariance = x[None], p[None]
  for _ in range(200):
    z = rng.normal()
    state, covariance = state @ F.T, kalman.predict(covariance, F, Q)
    state, covariance, _, _ = kalman.correct(state, covariance, 0, np.array([z]), R, np.array([True]))
    x, p = F @ x, F @ p @ F.T + Q
    gain = p[:, 0] / (p[0, 0] + R)
    x, p = x + gain * (z - x[0]), p - np.outer(gain, p[0])
    np.testing.assert_allclose(state[0], x, atol=1e-12)
    np.testing.assert_allclose(covariance[0], p, atol=1e-12)


def random_estimates(count, size, seed):
  rng = np.random.default_rng(seed)
  root = rng.normal(size=(count, size, size))
  return rng.normal(size=(count, size)), root @ root.transpose(0, 2, 1) + 0.1 * np.eye(size), rng


@pytest.mark.parametrize("rows", [(0,), (2, 5), (0, 1, 3)])
def test_component_by_component_is_filterpys_joint_update(rows):
  """State, covariance, NIS and determinant, for cars with all, some and none of the components."""
  x, p, rng = random_estimates(20, 6, seed=1)
  values, noise = rng.normal(size=(20, len(rows))), rng.uniform(0.1, 2.0, (20, len(rows)))
  used = rng.random((20, len(rows))) < 0.7
  used[0], used[1] = True, False
  corrected = kalman.correct_together(x, p, rows, np.where(used, values, np.nan), noise, used)
  for i in range(20):
    which = np.flatnonzero(used[i])
    if not len(which):
      np.testing.assert_array_equal(corrected.state[i], x[i])
      np.testing.assert_array_equal(corrected.covariance[i], p[i])
      assert corrected.nis[i] == corrected.log_determinant[i] == 0.0
      continue
    reference = Extended(x[i], p[i], np.zeros((6, 6)))
    slopes, spread = np.eye(6)[np.array(rows)[which]], np.diag(noise[i, which])
    innovation = values[i, which] - slopes @ x[i]
    assert corrected.nis[i] == pytest.approx(reference.nis(slopes, innovation, spread), rel=1e-9)
    reference.absorb(slopes, innovation, spread)
    np.testing.assert_allclose(corrected.state[i], reference.x, rtol=0, atol=1e-11)
    np.testing.assert_allclose(corrected.covariance[i], reference.P, rtol=0, atol=1e-11)
    assert corrected.log_determinant[i] == pytest.approx(math.log(np.linalg.det(reference.S)), abs=1e-9)


def test_a_measurement_along_any_slope_is_filterpys():
  x, p, rng = random_estimates(5, 6, seed=2)
  slope, innovation = rng.normal(size=(5, 6)), rng.normal(size=5)
  column = (p @ slope[:, :, None])[:, :, 0]
  spread = (slope * column).sum(axis=1) + R
  state, covariance = kalman.absorb(x, p, column, spread, innovation, np.ones(5, dtype=bool))
  for i in range(5):
    reference = Extended(x[i], p[i], np.zeros((6, 6)))
    reference.absorb(slope[i : i + 1], innovation[i : i + 1], np.array([[R]]))
    np.testing.assert_allclose(state[i], reference.x, atol=1e-11)
    np.testing.assert_allclose(covariance[i], reference.P, atol=1e-11)


# -- whole drives --------------------------------------------------------------------------------


def troubled(seconds, seed):
  """A weaving drive with spikes in every sensor, fixes without yaw, without x, and a yaw that wraps."""
  trip = journey(seconds, seed=seed)
  trip.yaw_rate += HARD.yaw_rate_bias
  trip.accel[:, 0] += HARD.accel_x_bias
  trip.speed[301::97] += 3.0
  trip.yaw_rate[333::89] -= 4.0
  trip.fix[400::300, 0] += 0.5
  trip.fix[350::200, 2] = np.nan
  trip.fix[370::250, 0] = np.nan
  trip.fix[:, 2] = np.remainder(trip.fix[:, 2] + math.pi, math.tau) - math.pi
  trip.fix[:, 3] = np.linspace(20.0, 85.0, len(trip.fix))
  return trip


@pytest.mark.parametrize("chosen", [FilterSettings(), HARD], ids=["plain", "hard"])
def test_a_drive_is_filterpys_drive_at_every_period(chosen):
  """Both local filters and the master, gates included, online and in a batch, against filterpy."""
  trip = troubled(12.0, seed=5)
  start, speed = tuple(trip.truth[0, [0, 1, 3]]), trip.truth[0, 2]
  reference = Reference(CAR, chosen, start, speed)
  online, batch = FederatedFilter(CAR, chosen, watched=False), FederatedBatch(CAR, chosen, 2)
  online.start(0.0, start, speed)
  batch.start(np.tile(start, (2, 1)), np.full(2, speed))
  batch.slots[0].accel = np.tile(trip.accel[0], (2, 1))
  for name, value in zip(("accel_x", "accel_y"), trip.accel[0], strict=True):
    online.update(0.0, name, value)
  worst = 0.0
  for k in range(1, len(trip.time)):
    fix = trip.fix[k] if np.isfinite(trip.fix[k, 3]) and k % 10 == 0 else None
    motion = trip.speed[k], trip.yaw_rate[k]
    reference.step(trip.commands[k - 1], trip.accel[k - 1], motion, fix)
    for name, value in zip(("motor_voltage", "steering_command"), trip.commands[k - 1], strict=True):
      online.update(trip.time[k - 1], name, value)
    samples = {"speed": motion[0], "yaw_rate": motion[1], "accel_x": trip.accel[k, 0], "accel_y": trip.accel[k, 1]}
    if fix is not None:
      samples |= dict(zip(("pose_x", "pose_y", "pose_yaw", "pose_score"), fix, strict=True))
    for name, value in samples.items():
      if np.isfinite(value):
        online.update(trip.time[k], name, value)
    one = online.estimate(trip.time[k])
    batch.command(np.tile(trip.commands[k - 1], (2, 1)))
    batch.advance(
      np.tile(motion, (2, 1)), np.tile(trip.accel[k], (2, 1)), None if fix is None else np.tile(fix, (2, 1))
    )
    position, spread = reference.position
    pairs = [
      (one.bicycle[0], reference.bicycle.x),
      (one.bicycle[1], reference.bicycle.P),
      (one.point[0], reference.point.x),
      (one.point[1], reference.point.P),
      (one[1:3], position),
      (one.covariance, spread[[0, 0, 1], [0, 1, 1]]),
      (batch.state.bicycle[1], reference.bicycle.x),
      (batch.state.point_covariance[1], reference.point.P),
    ]
    worst = max(worst, *(float(np.abs(np.subtract(a, b)).max()) for a, b in pairs))
  assert worst < 1e-9
  assert online.refused == reference.refused
  assert all(reference.refused[name, "gate"] >= 3 for name in ("pose", "speed", "yaw_rate"))


def test_covariances_stay_symmetric_and_positive_over_a_long_drive():
  trip = journey(60.0)
  batch = FederatedBatch(CAR, FilterSettings(), 1)
  batch.start(trip.truth[:1, [0, 1, 3]], trip.truth[:1, 2])
  for k in range(1, len(trip.time)):
    batch.command(trip.commands[k - 1 : k])
    fix = trip.fix[k : k + 1] if k % 10 == 0 else None
    batch.advance(np.array([[trip.speed[k], trip.yaw_rate[k]]]), trip.accel[k : k + 1], fix)
  for p in (batch.state.bicycle_covariance[0], batch.state.point_covariance[0]):
    np.testing.assert_allclose(p, p.T, rtol=0, atol=1e-12 * np.abs(p).max())
    assert np.linalg.eigvalsh(p).min() > 0.0


def test_the_centralised_filter_is_filterpys_with_the_accelerometer_as_a_measurement():
  chosen = FilterSettings(central=True, imu_y=0.02)
  trip = journey(6.0, seed=6)
  start = trip.truth[0, [0, 1, 3]]
  batch = FederatedBatch(CAR, chosen, 1)
  batch.start(start[None], trip.truth[:1, 2])
  reference = Reference(CAR, chosen, tuple(start), trip.truth[0, 2]).bicycle
  for k in range(1, len(trip.time)):
    batch.command(trip.commands[k - 1 : k])
    batch.advance(np.array([[trip.speed[k], trip.yaw_rate[k]]]), trip.accel[k : k + 1])
    following, entries = models.bicycle_step(tuple(reference.x), *trip.commands[k - 1], CAR, PERIOD)
    transition = np.eye(6)
    models.fill_jacobian(transition, entries, PERIOD)
    reference.predict_to(following, transition)
    motion = np.array([trip.speed[k], trip.yaw_rate[k]]) - reference.x[[2, 5]]
    reference.absorb(np.eye(6)[[2, 5]], motion, np.diag([chosen.speed_std**2, chosen.yaw_rate_std**2]))
    expected, by = models.lateral_acceleration(tuple(reference.x), trip.commands[k - 1, 1], CAR)
    slopes = np.zeros((1, 6))
    slopes[0, [2, 4, 5]] = by
    measured = trip.accel[k, 1] + chosen.imu_y * reference.x[5] ** 2
    reference.absorb(slopes, np.array([measured - expected]), np.array([[chosen.accel_std**2]]))
  np.testing.assert_allclose(batch.state.bicycle[0], reference.x, atol=1e-9)
  np.testing.assert_allclose(batch.state.bicycle_covariance[0], reference.P, atol=1e-9)


# -- the master ----------------------------------------------------------------------------------

covariances = st.tuples(st.floats(0.01, 10.0), st.floats(-0.95, 0.95), st.floats(0.01, 10.0)).map(
  lambda t: (t[0], t[1] * math.sqrt(t[0] * t[2]), t[2])
)
positions = st.tuples(st.floats(-5, 5), st.floats(-5, 5))


@settings(max_examples=100, deadline=None)
@given(positions, covariances, positions, covariances)
def test_written_out_fusion_is_the_information_fusion(p1, c1, p2, c2):
  state, covariance = fuse_positions(p1, c1, p2, c2)
  matrices = [np.array([[c[0], c[1]], [c[1], c[2]]]) for c in (c1, c2)]
  expected, spread = fuse([np.array(p1), np.array(p2)], matrices)
  np.testing.assert_allclose(state, expected, atol=1e-9, rtol=1e-9)
  np.testing.assert_allclose(covariance, spread[[0, 0, 1], [0, 1, 1]], atol=1e-9, rtol=1e-7)
  # fusing never loses: P_f <= P_1 and P_f <= P_2
  for matrix in matrices:
    assert np.linalg.eigvalsh(matrix - spread).min() > -1e-9


def test_fusion_of_many_at_once():
  states, covariance, _ = random_estimates(14, 2, seed=3)
  columns = lambda a: tuple(a.T)
  entries = lambda p: (p[:, 0, 0], p[:, 0, 1], p[:, 1, 1])
  positions, spread = fuse_positions(
    columns(states[:7]), entries(covariance[:7]), columns(states[7:]), entries(covariance[7:])
  )
  expected, fused = fuse([states[:7], states[7:]], [covariance[:7], covariance[7:]])
  np.testing.assert_allclose(np.stack(positions, axis=-1), expected, atol=1e-12)
  np.testing.assert_allclose(np.stack(spread, axis=-1), fused[:, [0, 0, 1], [0, 1, 1]], atol=1e-12)
