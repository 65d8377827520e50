"""How small an effect this driving would have shown: what the decision would say of each mechanism at each size.

Nothing is simulated. With d the change of all residuals by a mechanism of some size, less what the base parameters
imitate (`scan`), a car with k times that effect leaves the recalibrated twin at r - k d, and the right model at r, the
residuals that these recordings have. So the right model gains

    g_b(k) = k^2 |d|_b^2 / 2 - k (r d)_b

in each block b of driving, and what the base parameters had to do to imitate it costs k^2 a' P a / 2 nats of their
priors. The same holds of each channel and, with what is left of d beside another mechanism's, of what could be named
instead. These numbers go to the rule that decides (`decision.claims`), and k is the smallest at which it claims.

It is a prediction to first order, for one effect alone, on the blocks that are fitted, and as good as the twin without
the effect is the car. A mechanism that acts either way is tried either way.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.decision.claims import Claim, claim
from calibration.diagnosis.decision.evidence import Alternative, Evidence, Named, Taken
from calibration.diagnosis.decision.levels import Levels, usual_levels
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.scan import Signature
from calibration.diagnosis.score import from_blocks
from calibration.diagnosis.search.gather import measured_figures, seconds_of
from calibration.fitting.observations import CHANNELS
from qcar_twin.parameters import Parameter

Array = NDArray[np.float64]

RIVALS = 4  # mechanisms that look most alike and are weighed as what could be named instead
_LEAST, _STEPS = 0.01, 12  # of the scanned size, and steps in an octave
_OCTAVES = 13
_STRIDE = 6  # steps, half an octave: a size at which more is claimed than at both ends of one is not sought


@dataclasses.dataclass(frozen=True)
class Detectable:
  """From which size on a mechanism would be claimed.

  Attributes:
    mechanism: id.  parameter, unit: whose size it is.
    size: from which it, or what cannot be told from it, is claimed; None where its bounds are reached before.
    named: from which its own name is.
    share: `size` over its typical size.  nats: that the driving shows of it there, after absorption.
  """

  mechanism: str
  parameter: str
  unit: str
  size: float | None
  named: float | None
  share: float | None
  nats: float | None


@dataclasses.dataclass(frozen=True)
class _Sums:
  """Sums of squares of a change and of its product with the residuals.

  By block and channel, (B, C), and by second, (S,).
  """

  power: Array
  product: Array
  power_by_second: Array
  product_by_second: Array

  def gains(self, k: float) -> Array:
    """Nats by block and channel."""
    return 0.5 * k**2 * self.power - k * self.product

  def scores(self, k: float) -> tuple[float, ...]:
    """Slopes of the fit along the change in each second, over its norm, on a car that has k times the effect."""
    norm = abs(k) * float(np.sqrt(self.power_by_second.sum()))
    return tuple(((k**2 * self.power_by_second - k * self.product_by_second) / max(norm, 1e-12)).tolist())


def detectable(pool: Pool, evidence: Evidence, levels: Levels | None = None) -> dict[str, Detectable]:
  """By mechanism, for all that were scanned and of which these channels show anything.

  Args:
    pool: with the scan's signatures.
    evidence: of this data set, which says what else was tried.
    levels: what decides; those of levels.toml by default.
  """
  levels, prediction = levels or usual_levels(), Prediction(pool, evidence)
  seen = {name: s for name, s in pool.signatures.items() if s.shown > 0.0 and float(s.direction @ s.direction) > 0.0}
  return {name: _smallest(prediction, s, prediction.rivals(s, seen), levels) for name, s in sorted(seen.items())}


class Prediction:
  """What would be weighed on these recordings of a car with one effect."""

  def __init__(self, pool: Pool, evidence: Evidence):
    base, observations = pool.base, pool.problem.observations
    self.pool, self.evidence, self.residual = pool, evidence, base.residual[: base.n_train]
    block, channel = observations.block[: base.n_train], observations.channel[: base.n_train]
    self.blocks, self.channels = np.unique(block, return_inverse=True)[1], channel
    self.shape = (int(self.blocks.max()) + 1, int(channel.max()) + 1)
    self.error = np.bincount(channel, self.residual**2, minlength=self.shape[1])
    self.slopes = base.free.deviation_slopes(base.values)
    self.second = np.unique(seconds_of(observations)[: base.n_train], return_inverse=True)[1].reshape(-1)

  def sums(self, change: Array) -> _Sums:
    """Of a change of the fitted residuals, (K,)."""
    cell = self.blocks * self.shape[1] + self.channels
    fold = lambda values: (
      np.bincount(cell, values, minlength=self.shape[0] * self.shape[1]).astype(np.float64).reshape(self.shape)
    )
    by_second = lambda values: np.bincount(self.second, values).astype(np.float64)
    power, product = change**2, change * self.residual
    return _Sums(fold(power), fold(product), by_second(power), by_second(product))

  def rivals(self, signature: Signature, seen: Mapping[str, Signature]) -> list[tuple[str, _Sums]]:
    """Those most alike: name, and what is left where it stands in for this one."""
    own, found = signature.direction.astype(np.float64), []
    for name, other in seen.items():
      direction = other.direction.astype(np.float64)
      share = float(own @ direction) / float(direction @ direction)
      if name != signature.mechanism and (share > 0.0 or self.pool.problem.mechanism(name).signed):
        found.append((share**2 * float(direction @ direction), name, share))
    best = sorted(found, reverse=True)[:RIVALS]
    return [(name, self.sums(own - share * seen[name].direction.astype(np.float64))) for _, name, share in best]

  def named(self, signature: Signature, own: _Sums, rivals: list[tuple[str, _Sums]], k: float) -> Named:
    """The mechanism at k times its scanned size, as it would be weighed."""
    gains = own.gains(k)
    answer = np.array([signature.imitated.get(name, 0.0) for name in self.pool.base.free.names])
    priors = 0.5 * k**2 * float(np.sum((self.slopes * answer) ** 2))
    before = self.error + 2.0 * gains.sum(axis=0)
    test = from_blocks(gains.sum(axis=1), 0.5 * float(before.sum()))
    drop = float(gains.sum()) + priors
    errors = []
    for index in np.flatnonzero(self.error > 0.0):
      share = 1.0 - float(np.sqrt(self.error[index] / max(before[index], 1e-12)))
      errors.append(Taken(CHANNELS[index], share, from_blocks(gains[:, index], 0.5 * float(before[index])).t))
    others = tuple(self._alternative(name, gains, left.gains(k), priors) for name, left in rivals)
    bent = dataclasses.replace(self.pool.base, values=self.pool.base.values - k * answer)
    without = measured_figures(bent, self.pool.problem.twin, self.pool.problem.observations)
    return Named(
      name=signature.mechanism, held_out=dataclasses.replace(test, priors=priors, drop=drop),
      at_bound=False, errors=tuple(errors), estimates=(), alternatives=others, scores=own.scores(k), without=without,
    )  # fmt: skip

  def _alternative(self, name: str, gains: Array, ahead: Array, priors: float) -> Alternative:
    """Another name in its place: what is `ahead` of it is what it leaves."""
    reached = from_blocks((gains - ahead).sum(axis=1), 0.0)
    nats = float((gains - ahead).sum())
    return Alternative(name, nats, reached.t, False, from_blocks(ahead.sum(axis=1), 0.0).t, priors)


def amplitude(signature: Signature, parameters: Sequence[Parameter]) -> Parameter:
  """The parameter that was scanned: of those that do nothing at their null, the one that is farthest from it."""
  away = lambda p: abs(_step(signature, p)) / (p.typical or p.scale)
  return max((p for p in parameters if p.null is not None and p.name in signature.tried), key=away)


def _step(signature: Signature, parameter: Parameter) -> float:
  """How far from its null it was scanned."""
  return signature.tried[parameter.name] - (parameter.null or 0.0)


def _first(count: int, holds: Callable[[int], bool]) -> int | None:
  """Least of so many sizes at which something holds: by strides to one that has it, then from the last that had not."""
  ends = [*range(_STRIDE - 1, count - 1, _STRIDE), count - 1] if count else []
  end = next((k for k in ends if holds(k)), None)
  return None if end is None else next(k for k in range(max(0, end - _STRIDE + 1), end + 1) if holds(k))


def _smallest(
  prediction: Prediction, signature: Signature, rivals: list[tuple[str, _Sums]], levels: Levels
) -> Detectable:
  mechanism = prediction.pool.problem.mechanism(signature.mechanism)
  parameter = amplitude(signature, mechanism.parameters)
  step, null = _step(signature, parameter), parameter.null or 0.0
  own = prediction.sums(signature.direction.astype(np.float64))
  room = max((bound - null) / step for bound in (parameter.lower, parameter.upper))
  signs = (1.0, -1.0) if mechanism.signed else (1.0,)
  sizes = _LEAST * 2.0 ** (np.arange(_OCTAVES * _STEPS) / _STEPS)
  sizes = sizes[sizes <= room]

  @functools.cache
  def claims(index: int) -> list[Claim]:
    k = float(sizes[index])
    evidence = prediction.evidence
    return [claim(prediction.named(signature, own, rivals, s * k), evidence.base, evidence, levels) for s in signs]

  found: dict[str, float] = {}
  for what in ("shared", "probability"):
    likely = lambda i, what=what: float(np.mean([getattr(c, what) for c in claims(i)]))
    reached = _first(len(sizes), lambda i, likely=likely: likely(i) >= levels.claim)
    if reached is not None:
      found[what] = float(sizes[reached])
  sized = {what: k * abs(step) for what, k in found.items()}
  size = sized.get("shared")
  return Detectable(
    mechanism=signature.mechanism,
    parameter=parameter.name,
    unit=parameter.unit,
    size=size,
    named=sized.get("probability"),
    share=None if size is None else size / (parameter.typical or parameter.scale),
    nats=None if size is None else 0.5 * found["shared"] ** 2 * float(own.power.sum()),
  )
