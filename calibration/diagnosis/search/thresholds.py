"""What is significant and what matters: the limits a name must pass, and the tests against them."""

import dataclasses
import math

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.score import Comparison

_LOST = 0.25  # of what the priors bring, that held-out evidence may take away again


@dataclasses.dataclass(frozen=True)
class Thresholds:
  """What a claim needs; set by hand on sessions of the proving ground.

  What sessions without any effect reach is listed on a campaign's page.

  Attributes:
    t: held-out gain over its standard error.
    sure: such a gain is not chance: a name with it is not dropped for being `worse` on few recordings, and where none
      of several reaches `probability` the verdict is not "no mismatch".
    nats: held-out gain, and no more of it than the fit gained.
    shape: nats more for every parameter but the first: a change of grip at any time, by any amount, finds one that
      fits.
    sought: by which the square of t must be larger for every parameter but two, as in Akaike's criterion: the place of
      a slippery patch is chosen on all recordings, those left out among them.
    many, t_many: more nats than chance brings will do with a smaller t: an effect that acts now and then scatters.
    much, t_much: with a share of all that is missed that chance does not explain, the same with a smaller t still:
      a formula that is wrong in shape makes some blocks worse, and what it brings the others is capped.
    share: groups that gained.
    clear: a share of all that is missed, nearly twice what sessions without effects reach, from which on `nats`
      and `t_many` will do, wherever it was sought: what acts in one place is seen in few blocks.
    priors: nats by which a mechanism must free measured parameters from what they were bent to, where recalibration
      leaves no residual of it.
    material: share of the typical size: the twin's own simplifications look like a tenth of some effects, however
      clearly.
    further: the same for a mechanism that comes to others, for which `many` nats don't help, either: a first formula
      that is right in kind but not in every detail leaves small things over.
    bias: the same for biases of the IMU and the encoder's lag, of which every one has some.
    beside: share of the cost explained so far, at all or in the channels where it shows, that a further mechanism
      must bring: a formula that is right in kind but not in every detail leaves about that much for others to pick up.
    trace, plain: a smaller share will do, but at least `trace`, for a mechanism of at least `plain` typical sizes.
    rest, full: so will a share of all that is missed beside the first, more than sessions without effects reach, for
      one of at least `full` typical sizes: next to a very strong first any other is less than a trace.
    probability: a name less likely right than this is not claimed.
    worse: a set of names by which recordings that only judge are predicted worse by this factor is cut down, but
      for those that explain `much` or are `sure`.
    spoiled: a set of names by which one channel of theirs gets worse by this factor is cut down, unless all that it
      makes worse is less than `beside` of what it makes better, in nats.
    equivalent: a rival within so many standard errors of the claim can't be told apart.
  """

  t: float = 2.6
  sure: float = 3.0
  nats: float = 20.0
  shape: float = 2.0
  sought: float = 2.0
  many: float = 45.0
  t_many: float = 1.8
  much: float = 0.1
  t_much: float = 1.2
  clear: float = 0.06
  share: float = 0.55
  priors: float = 60.0
  material: float = 0.15
  further: float = 0.25
  bias: float = 0.55
  beside: float = 0.05
  trace: float = 0.01
  plain: float = 0.4
  rest: float = 0.04
  full: float = 0.8
  probability: float = 0.4
  worse: float = 1.01
  spoiled: float = 1.6
  equivalent: float = 1.0

  def beside_others(self) -> "Thresholds":
    """What a mechanism beside others needs."""
    return dataclasses.replace(self, many=np.inf, clear=np.inf)


def significant(test: Comparison, thresholds: Thresholds) -> bool:
  """By held-out evidence, or, where an effect is absorbed, by the parameters it lets go back to what was believed.

  One that predicts recordings left out much worse has freed them by imitating something else.
  """
  if test.priors >= thresholds.priors and test.total > -_LOST * test.priors:
    return True
  return strength(test, thresholds) >= 1.0 and test.share_positive >= thresholds.share


def strength(test: Comparison, thresholds: Thresholds) -> float:
  """Held-out evidence in units of what a claim needs, as far as the fit bears it out.

  The held-out part counts validation recordings and leaves out what the priors cost, so that by chance it may exceed
  what the fit itself gained.
  """
  gain = min(test.gain, test.drop) - thresholds.shape * max(test.added - 1, 0)
  t = lambda limit: test.t / math.hypot(limit, math.sqrt(thresholds.sought * max(test.added - 2, 0)))
  usual = min(t(thresholds.t), gain / thresholds.nats)
  enough = max(t(thresholds.t_many), min(t(thresholds.t_much), test.relative / thresholds.much))
  clear = min(test.t / thresholds.t_many, test.relative / thresholds.clear, gain / thresholds.nats)
  return max(usual, min(enough, gain / thresholds.many), clear)


def material(pool: Pool, model: Candidate, name: str, share: float) -> bool:
  """Whether any amplitude, as far as the driving shows it, reaches a share of its typical size, and its deviation.

  That it is there at all is for the evidence to say: amplitudes of one mechanism may be known together and not singly.
  """
  mechanism = pool.problem.mechanism(name)
  shown = mechanism.observable_share(model.free.named(model.values), pool.problem.driving)
  for parameter in mechanism.parameters:
    if parameter.null is None or parameter.name not in model.free:
      continue
    value, std = model.estimate(parameter.name)
    size = abs(value - parameter.null)
    if shown * size >= share * (parameter.typical or parameter.scale) and size >= std:
      return True
  return False


def stretched(pool: Pool, model: Candidate, name: str) -> bool:
  """Whether an amplitude went as far as it may, to a standard deviation.

  What it then makes up for is more often something else.
  """
  for p in pool.problem.mechanism(name).parameters:
    if p.null is None or p.name not in model.free:
      continue
    value, std = model.estimate(p.name)
    if any(abs(value - bound) < max(std, 1e-6 * p.scale) for bound in (p.lower, p.upper) if bound != p.null):
      return True
  return False
