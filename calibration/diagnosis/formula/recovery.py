"""The missing force as a function of time: a linear smoother on what a model leaves over.

  y = J f + J_b d + e,   f ~ GP(0, s^2 k),   d ~ N(0, priors),   e ~ N(0, 1)

y is minus the whitened residual, J the answers to pulses, J_b those of the model's own parameters, which may move
meanwhile. k is a Matern kernel of order 3/2; its length and scale are those of the largest evidence (Rasmussen and
Williams, Gaussian Processes for Machine Learning, 2006, eq. 2.30 and ch. 5). One eigendecomposition per stretch and
length does for all scales, so the evidence of a degree of freedom is linear algebra.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.formula.pulses import WIDTH, Responses
from calibration.fitting.optimiser import prior_gradient

Array = NDArray[np.float64]

LENGTHS = (0.1, 0.3, 1.0, 3.0)  # s
SHARES = tuple(10.0**k for k in np.arange(-3.0, 0.01, 0.5))  # of the degree's natural size


@dataclasses.dataclass(frozen=True)
class Recovered:
  """A force over time on one degree of freedom.

  Attributes:
    degree: where it acts.
    evidence: log evidence over no force, nats.
    length: over which it changes, s.
    scale: its standard deviation, as a share of the degree's natural size.
    force: per stretch and pulse, (S, K), as the same share.
    std: posterior standard deviation, (S, K).
  """

  degree: str
  evidence: float
  length: float
  scale: float
  force: Array
  std: Array


@dataclasses.dataclass(frozen=True)
class Base:
  """What the model's own parameters can do about its residual, over the values that are fitted.

  Attributes:
    target: minus the whitened residual, (M,).
    jacobian: in units of the parameters' scales, (M, p).
    curvature: with the priors', (p, p).
    pull: slope of the fit, (p,).
  """

  target: Array
  jacobian: Array
  curvature: Array
  pull: Array

  @classmethod
  def of(cls, model: Candidate) -> "Base":
    """Of a fitted model. What stands at a bound may move too: its prior holds it."""
    n, unit = model.n_train, model.free.scale
    jacobian, target = model.jacobian[:n] * unit, -model.residual[:n]
    priors = model.free.deviation_slopes(model.values) * unit
    curvature = jacobian.T @ jacobian + np.diag(priors**2) + 1e-9 * np.eye(len(unit))
    pull = jacobian.T @ target - prior_gradient(model.values, model.free) * unit
    return cls(target, jacobian, curvature, pull)

  def without(self, columns: Array) -> Array:
    """Columns (M, D) less what the parameters can imitate of them."""
    return columns - self.jacobian @ np.linalg.solve(self.curvature, self.jacobian.T @ columns)

  @property
  def rest(self) -> Array:
    """The target less what the parameters still promise, (M,)."""
    return self.target - self.jacobian @ np.linalg.solve(self.curvature, self.pull)


def recover(base: Base, responses: Responses) -> Recovered:
  """The force of the largest evidence on one degree of freedom."""
  fitted = [rows for rows in responses.rows if len(rows) and rows[-1] < len(base.target)]
  columns = [c for rows, c in zip(responses.rows, responses.columns, strict=True)
             if len(rows) and rows[-1] < len(base.target)]  # fmt: skip
  own = [(c.T @ c, c.T @ base.jacobian[rows], c.T @ base.target[rows])
         for rows, c in zip(fitted, columns, strict=True)]  # fmt: skip
  best = max((_best_scale(base, own, length) for length in LENGTHS), key=lambda found: found[0])
  evidence, length, share = best
  force, std = _posterior(base, own, length, share)
  whole = [np.zeros((len(responses.rows), responses.pulses)) for _ in range(2)]
  places = [s for s, rows in enumerate(responses.rows) if len(rows) and rows[-1] < len(base.target)]
  whole[0][places], whole[1][places] = force, std
  return Recovered(responses.degree, evidence, length, share, whole[0], whole[1])


def kernel(count: int, length: float) -> Array:
  """Matern 3/2 between pulses, (K, K)."""
  apart = np.sqrt(3.0) * np.abs(np.subtract.outer(np.arange(count), np.arange(count))) * WIDTH / length
  return (1.0 + apart) * np.exp(-apart)


Own = Sequence[tuple[Array, Array, Array]]  # of each stretch: J'J, J'J_b, J'y


def _root(count: int, length: float) -> Array:
  return np.asarray(np.linalg.cholesky(kernel(count, length) + 1e-9 * np.eye(count)), dtype=np.float64)


def _best_scale(base: Base, own: Own, length: float) -> tuple[float, float, float]:
  """Evidence, length and scale of the best scale."""
  root, parts = _root(len(own[0][0]), length), []
  for gram, cross, pull in own:
    values, vectors = np.linalg.eigh(root.T @ gram @ root)
    turned = vectors.T @ root.T
    parts.append((np.maximum(values, 0.0), turned @ cross, turned @ pull))
  return max((_evidence(base, parts, share), length, share) for share in SHARES)


def _evidence(base: Base, parts: Own, share: float) -> float:
  nothing = _settled(base.curvature, base.pull)
  curvature, pull, total = base.curvature.copy(), base.pull.copy(), 0.0
  for values, cross, own in parts:
    damped = share**2 / (1.0 + share**2 * values)
    total += 0.5 * float(own @ (damped * own)) - 0.5 * float(np.sum(np.log1p(share**2 * values)))
    curvature -= cross.T @ (damped[:, None] * cross)
    pull -= cross.T @ (damped * own)
  return total + _settled(curvature, pull) - nothing


def _settled(curvature: Array, pull: Array) -> float:
  """Log of the integral over the parameters, up to a constant."""
  sign, size = np.linalg.slogdet(curvature)
  return 0.5 * float(pull @ np.linalg.solve(curvature, pull)) - 0.5 * float(size) if sign > 0 else -np.inf


def _posterior(base: Base, own: Own, length: float, share: float) -> tuple[Array, Array]:
  """Mean and standard deviation of the force, (S, K) each."""
  count = len(own[0][0])
  prior, curvature, pull, held = share**2 * kernel(count, length), base.curvature.copy(), base.pull.copy(), []
  root = share * _root(count, length)
  for gram, cross, towards in own:
    inner = np.eye(count) + root.T @ gram @ root
    spread = root @ np.linalg.solve(inner, root.T)
    held.append(spread)
    curvature -= cross.T @ spread @ cross
    pull -= cross.T @ (spread @ towards)
  inverse = np.linalg.inv(curvature)
  moved = inverse @ pull
  force, std = np.empty((len(own), count)), np.empty((len(own), count))
  for s, (_, cross, towards) in enumerate(own):
    force[s] = held[s] @ (towards - cross @ moved)
    through = held[s] @ cross
    variance = np.diag(held[s]) + np.einsum("ij,jk,ik->i", through, inverse, through)
    std[s] = np.sqrt(np.clip(variance, 0.0, np.diag(prior)))
  return force, std
