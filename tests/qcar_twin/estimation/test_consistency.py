"""NEES and NIS inside their chi-square bounds over 100 seeds when the model is true, and not when it is not."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from qcar_twin.estimation import kalman, models
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.offline import position_nees
from qcar_twin.estimation.settings import FilterSettings
from tests.qcar_twin.estimation.estimation_rig import CAR, PERIOD, hold
from tests.qcar_twin.estimation.filterpy_reference import fuse

SEEDS = 100
CONFIDENCE = 0.999


def nees(error, covariance):
  """Normalised estimation error squared e' P^-1 e, (...), of errors (..., n) and covariances (..., n, n)."""
  return np.einsum("...i,...i->...", error, np.linalg.solve(covariance, error[..., None])[..., 0])


def bounds(dimension, samples):
  """Two-sided bounds on the mean of `samples` independent chi-square variables."""
  tail = 0.5 * (1.0 - CONFIDENCE)
  return chi2.ppf(tail, dimension * samples) / samples, chi2.isf(tail, dimension * samples) / samples


def drive_bicycle(settings, steps=300, noise_scale=1.0):
  """100 cars that obey EKF_BM's model with its own process noise; yields NEES, NIS per step."""
  rng = np.random.default_rng(11)
  start = np.tile([0.0, 0.0, 0.5, 0.2, 0.0, 0.0], (SEEDS, 1))
  batch = FederatedBatch(CAR, settings, SEEDS)
  batch.start(start[:, [0, 1, 3]], start[:, 2])
  initial = np.linalg.cholesky(batch.state.bicycle_covariance[0])
  truth = start + rng.standard_normal((SEEDS, 6)) @ initial.T
  root = np.linalg.cholesky(settings.bicycle_noise)
  position, yaw = settings.pose_noise(settings.score)
  out = []
  for k in range(1, steps + 1):
    commands = np.tile([hold(0.5), 0.2 * np.sin(0.02 * k)], (SEEDS, 1))
    batch.command(commands)
    truth = np.stack(models.bicycle_step(tuple(truth.T), *commands.T, CAR, PERIOD, np)[0], axis=-1)
    truth = truth + rng.standard_normal((SEEDS, 6)) @ root.T
    noise = noise_scale * rng.standard_normal((SEEDS, 5))
    motion = truth[:, [2, 5]] + noise[:, :2] * (settings.speed_std, settings.yaw_rate_std)
    fix = None
    if k % 10 == 0:
      fix = truth[:, [0, 1, 3, 3]] + np.pad(noise[:, 2:] * np.sqrt([position, position, yaw]), ((0, 0), (0, 1)))
      fix[:, 3] = settings.score
    batch.advance(motion, np.full((SEEDS, 2), np.nan), fix)
    error = truth - batch.state.bicycle
    out.append(
      (np.mean(nees(error, batch.state.bicycle_covariance)), np.mean(batch.nis[:, 0]) if fix is not None else np.nan)
    )
  return np.array(out).T


def test_nees_and_nis_of_the_bicycle_filter():
  """Mean over 100 runs at single instants 0.5 s apart, and over all instants for the NIS (white in time)."""
  each, nis = drive_bicycle(FilterSettings(gate=1e-9))
  low, high = bounds(6, SEEDS)
  inside = (each[50::50] > low) & (each[50::50] < high)
  assert inside.all(), each[50::50]
  fixes = nis[np.isfinite(nis)]
  low, high = bounds(3, SEEDS * len(fixes))
  assert low < fixes.mean() < high


def test_nees_tells_a_filter_that_believes_too_much():
  each, nis = drive_bicycle(FilterSettings(gate=1e-12), noise_scale=1.5)
  assert each[100:].mean() > bounds(6, SEEDS)[1]
  assert np.nanmean(nis) > bounds(3, SEEDS)[1]


def point_runs(settings, steps, sharing):
  """Two point filters per car on one truth, the same lidar in both: position NEES of the master, NEES of one alone."""
  values = {}
  position, _ = settings.pose_noise(settings.score)
  root = np.linalg.cholesky(settings.point_noise)
  transition = np.eye(4)
  transition[0, 2] = transition[1, 3] = PERIOD
  everyone = np.ones((SEEDS, 2), dtype=bool)
  for kind, share in (("consistent", sharing), ("printed", (1.0, 1.0))):
    rng = np.random.default_rng(12)
    truth = 0.02 * rng.standard_normal((SEEDS, 4))
    locals_ = [(np.zeros((SEEDS, 4)), np.tile(4e-4 * np.eye(4), (SEEDS, 1, 1))) for _ in share]
    for k in range(1, steps + 1):
      truth = truth @ transition.T + rng.standard_normal((SEEDS, 4)) @ root.T
      locals_ = [(x @ transition.T, kalman.predict(p, transition, settings.point_noise)) for x, p in locals_]
      if k % 10 == 0:
        z = truth[:, :2] + np.sqrt(position) * rng.standard_normal((SEEDS, 2))
        noise = np.full((SEEDS, 2), position)
        locals_ = [
          kalman.correct_together(x, p, (0, 1), z, noise / beta, everyone)[:2]
          for (x, p), beta in zip(locals_, share, strict=True)
        ]
    state, covariance = fuse([x[:, :2] for x, _ in locals_], [p[:, :2, :2] for _, p in locals_])
    alone = nees(truth - locals_[0][0], locals_[0][1])
    values[kind] = np.mean(nees(truth[:, :2] - state, covariance)), np.mean(alone)
  return values


def test_point_filter_is_consistent_and_the_printed_fusion_is_not():
  """Both filters use the same fixes in full: the printed P_f is half of what it should be, NEES 4 instead of 2."""
  scores = point_runs(FilterSettings(), steps=100, sharing=(0.5, 0.5))
  low, high = bounds(4, SEEDS)
  assert low < scores["printed"][1] < high  # a local filter alone, with the fix in full, is consistent
  assert scores["printed"][0] > bounds(2, SEEDS)[1]
  assert 3.2 < scores["printed"][0] < 4.8
  assert scores["consistent"][0] < scores["printed"][0]


def test_written_out_nees_is_nees():
  rng = np.random.default_rng(0)
  error, root = rng.normal(size=(20, 2)), rng.normal(size=(20, 2, 2))
  covariance = root @ root.transpose(0, 2, 1) + np.eye(2)
  np.testing.assert_allclose(
    position_nees(error, covariance[:, [0, 0, 1], [0, 1, 1]]), nees(error, covariance), rtol=1e-10
  )


def test_correlated_lidar_errors_are_weighed_by_what_they_tell():
  """R (1 + a)/(1 - a) makes the average of correlated fixes as certain as it is: checked on a constant."""
  correlation, interval, std = 0.3, 0.1, 0.008
  settings = FilterSettings(lidar_correlation=correlation, lidar_interval=interval)
  a = np.exp(-interval / correlation)
  rng = np.random.default_rng(1)
  series = np.empty((400, 1000))  # time, runs
  series[0] = rng.standard_normal(1000)
  for k in range(1, 400):
    series[k] = a * series[k - 1] + np.sqrt(1 - a * a) * rng.standard_normal(1000)
  means = std * series.mean(axis=0)
  assert np.var(means) == pytest.approx(settings.lidar_factor * std**2 / 400, rel=0.15)
  assert dataclasses.replace(settings, lidar_correlation=0.0).lidar_factor == 1.0
