"""The filter against the dense Gaussian it stands for."""

import numpy as np

from calibration.likelihood.filter import Chain, smooth, whiten

COUNT, SIZE = 6, 13  # windows; 7 motions, 3 forces, 3 other errors


def chain(rng: np.random.Generator) -> Chain:
  begins = np.array([True, False, False, True, False, False])
  return Chain(
    slopes=np.triu(rng.normal(size=(COUNT, SIZE, SIZE))),
    transition=0.4 * rng.normal(size=(COUNT, 7, 10)),
    begins=begins,
    memory=np.array([0.6, 0.6, 0.6, 0.3, 0.3, 1.0]),
    leak=np.full(7, 0.01),
    prior=np.full(7, 0.5),
  )


def dense(c: Chain, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  """Mean and covariance of all windows' states, written out."""
  mean, cov = np.zeros((COUNT, SIZE)), np.zeros((COUNT * SIZE, COUNT * SIZE))
  for j in range(COUNT):
    own = slice(j * SIZE, (j + 1) * SIZE)
    if c.begins[j]:
      mean[j, :7] = first[j]
      cov[own, own] = np.diag([*c.prior, *np.ones(SIZE - 7)])
      continue
    step = np.zeros((SIZE, SIZE))
    step[:7, :10] = c.transition[j - 1]
    step[7:, 7:] = np.diag(c.memory)
    before = slice((j - 1) * SIZE, j * SIZE)
    mean[j] = step @ mean[j - 1]
    cov[own, : j * SIZE] = step @ cov[before, : j * SIZE]
    cov[: j * SIZE, own] = cov[own, : j * SIZE].T
    cov[own, own] = step @ cov[before, before] @ step.T + np.diag([*c.leak, *(1.0 - c.memory**2)])
  return mean, cov


def test_innovations_have_the_likelihood_of_the_dense_gaussian():
  rng = np.random.default_rng(5)
  c, first = chain(rng), 0.3 * rng.normal(size=(COUNT, 7))
  readings = rng.normal(size=(COUNT, SIZE, 1))
  out, half, _ = whiten(c, readings, np.zeros((COUNT, 7, 1)), first)
  mean, cov = dense(c, first)
  h = np.zeros((COUNT * SIZE, COUNT * SIZE))
  for j in range(COUNT):
    h[j * SIZE : (j + 1) * SIZE, j * SIZE : (j + 1) * SIZE] = c.slopes[j]
  spread = h @ cov @ h.T + np.eye(COUNT * SIZE)
  error = readings.ravel() - h @ mean.ravel()
  assert np.isclose(np.sum(out**2), error @ np.linalg.solve(spread, error), rtol=1e-8)
  assert np.isclose(half, 0.5 * np.linalg.slogdet(spread)[1], rtol=1e-8)


def test_the_smoother_gives_the_dense_gaussians_mean():
  rng = np.random.default_rng(6)
  c, first, readings = chain(rng), np.zeros((COUNT, 7)), rng.normal(size=(COUNT, SIZE, 1))
  _, _, states = whiten(c, readings, np.zeros((COUNT, 7, 1)), first, keep=True)
  assert states is not None
  mean, cov = dense(c, first)
  h = np.zeros((COUNT * SIZE, COUNT * SIZE))
  for j in range(COUNT):
    h[j * SIZE : (j + 1) * SIZE, j * SIZE : (j + 1) * SIZE] = c.slopes[j]
  gain = cov @ h.T @ np.linalg.inv(h @ cov @ h.T + np.eye(COUNT * SIZE))
  expected = mean.ravel() + gain @ (readings.ravel() - h @ mean.ravel())
  assert np.allclose(smooth(c, states).ravel(), expected, atol=1e-6)


def test_a_column_is_whitened_as_the_change_it_makes():
  rng = np.random.default_rng(7)
  c, first = chain(rng), np.zeros((COUNT, 7))
  z, column = rng.normal(size=(COUNT, SIZE, 1)), rng.normal(size=(COUNT, SIZE, 1))
  gap, end = rng.normal(size=(COUNT, 7, 1)), rng.normal(size=(COUNT, 7, 1))
  both, _, _ = whiten(c, np.concatenate([z, column], 2), np.concatenate([gap, -end], 2), first)
  after, _, _ = whiten(c, z - 0.3 * column, gap + 0.3 * end, first)
  assert np.allclose(both[..., 0] - 0.3 * both[..., 1], after[..., 0], atol=1e-9)


def test_a_covariance_that_is_none_is_told():
  c = chain(np.random.default_rng(8))
  c.prior[:] = -1e6
  assert whiten(c, np.ones((COUNT, SIZE, 1)), np.zeros((COUNT, 7, 1)), np.zeros((COUNT, 7)))[1] == np.inf
