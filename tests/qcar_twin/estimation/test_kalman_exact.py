"""Reductions to exact things: the Kalman filter, the centralised filter, the written-out fusion."""

import math

import numpy as np
import pytest
from estimation_rig import CAR, PERIOD, hold
from hypothesis import given, settings
from hypothesis import strategies as st

from qcar_twin.estimation import models
from qcar_twin.estimation.kalman import LocalFilter
from qcar_twin.estimation.master import Federation, fuse, fuse_positions

F = np.array([[1.0, 0.1], [-0.2, 0.95]])
Q = np.array([[0.02, 0.005], [0.005, 0.03]])
R = np.array([[0.4]])


def textbook(z, x, p):
  """Kalman filter, covariance form, one predict and one update of the first state."""
  x, p = F @ x, F @ p @ F.T + Q
  s = p[0, 0] + R[0, 0]
  gain = p[:, 0] / s
  return x + gain * (z - x[0]), p - np.outer(gain, p[0])


def test_extended_filter_on_a_linear_model_is_the_kalman_filter():
  rng = np.random.default_rng(0)
  local = LocalFilter(np.array([1.0, -1.0]), np.eye(2), Q)
  x, p = np.array([1.0, -1.0]), np.eye(2)
  for _ in range(200):
    z = rng.normal()
    local.predict_to(F @ local.x, F)
    local.correct((0,), np.array([z - local.x[0]]), R)
    x, p = textbook(z, x, p)
    np.testing.assert_allclose(local.x, x, atol=1e-12)
    np.testing.assert_allclose(local.P, p, atol=1e-12)


def test_a_measurement_matrix_and_a_selection_of_rows_agree():
  one, two = (LocalFilter(np.zeros(3), np.diag([1.0, 2.0, 3.0]) + 0.3, np.eye(3)) for _ in range(2))
  noise = np.diag([0.1, 0.2])
  one.correct((0, 2), np.array([0.5, -0.4]), noise)
  two.correct_with(np.eye(3)[[0, 2]], np.array([0.5, -0.4]), noise)
  np.testing.assert_array_equal(one.P, two.P)
  np.testing.assert_array_equal(one.x, two.x)


def test_snapshots_are_not_written_into():
  local = LocalFilter(np.zeros(2), np.eye(2), Q)
  before = local.snapshot
  kept = before[0].copy(), before[1].copy()
  local.predict_to(np.ones(2), F)
  local.correct((1,), np.array([0.3]), R)
  np.testing.assert_array_equal(before[0], kept[0])
  np.testing.assert_array_equal(before[1], kept[1])
  local.restore(before)
  np.testing.assert_array_equal(local.P, np.eye(2))


@pytest.mark.parametrize("sharing", [(0.5, 0.5), (0.2, 0.8), (0.3, 0.3, 0.4)])
def test_federation_with_reset_is_the_centralised_filter_linear(sharing):
  rng = np.random.default_rng(1)
  federation = Federation(np.zeros(2), np.eye(2), Q, sharing)
  central = LocalFilter(np.zeros(2), np.eye(2), Q)
  for _ in range(100):
    central.predict_to(F @ central.x, F)
    federation.predict_to(F @ federation.locals[0].x, F)
    for i, local in enumerate(federation.locals):
      row, z, noise = (i % 2,), rng.normal(), np.array([[0.3 + 0.1 * i]])
      central.correct(row, np.array([z - central.x[row[0]]]), noise)
      local.correct(row, np.array([z - local.x[row[0]]]), noise)
    state, covariance = federation.reset()
    np.testing.assert_allclose(state, central.x, atol=1e-12)
    np.testing.assert_allclose(covariance, central.P, atol=1e-12)


def test_federation_with_reset_is_the_centralised_filter_on_the_bicycle():
  """EKF_BM twice: one local filter has the lidar, the other encoder and gyro; half the lidar fix each way too."""
  rng = np.random.default_rng(2)
  start = np.array([0.0, 0.0, 0.5, 0.2, 0.0, 0.0])
  spread, noise = np.diag(np.square([0.05, 0.05, 0.1, 0.05, 0.05, 0.2])), np.diag([1e-6, 1e-6, 1e-3, 1e-6, 2e-4, 4e-2])
  federation = Federation(start, spread, noise, (0.4, 0.6))
  central = LocalFilter(start, spread, noise)
  lidar, motion = np.diag([6e-5, 6e-5, 6e-5]), np.diag([1e-4, 4e-4])

  def predict(one):
    following, entries = models.bicycle_step(tuple(one.x.tolist()), hold(0.5), 0.2, CAR, PERIOD)
    transition = np.eye(6)
    models.fill_jacobian(transition, entries, PERIOD)
    return np.array(following), transition

  for k in range(200):
    central.predict_to(*predict(central))
    federation.predict_to(*predict(federation.locals[0]))
    before = central.x.copy()
    z = before[[2, 5]] + 0.01 * rng.normal(size=2)
    fix = before[[0, 1, 3]] + 0.008 * rng.normal(size=3)
    rows, every = ((2, 5), motion), (((0, 1, 3), lidar),) if k % 10 == 0 else ()
    for local in (central, federation.locals[1]):
      local.correct(rows[0], z - local.x[list(rows[0])], rows[1])
    for which, information in every:
      central.correct(which, fix - central.x[list(which)], information)
      for local, share in zip(federation.locals, (0.7, 0.3), strict=True):
        local.correct(which, fix - local.x[list(which)], information / share)
    state, covariance = federation.reset()
    np.testing.assert_allclose(state, central.x, atol=1e-12)
    np.testing.assert_allclose(covariance, central.P, atol=1e-12)


def test_sharing_factors_must_be_positive():
  with pytest.raises(ValueError, match="positive"):
    Federation(np.zeros(2), np.eye(2), Q, (0.0, 1.0))


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
  rng = np.random.default_rng(3)
  roots = rng.normal(size=(2, 7, 3, 3))
  covariance = roots @ roots.transpose(0, 1, 3, 2) + np.eye(3)
  states = rng.normal(size=(2, 7, 3))
  fused, spread = fuse(list(states), list(covariance))
  for i in range(7):
    alone = fuse(list(states[:, i]), list(covariance[:, i]))
    np.testing.assert_allclose(fused[i], alone[0], atol=1e-12)
    np.testing.assert_allclose(spread[i], alone[1], atol=1e-12)
