"""The numbers that decide, and the probability that a name is right.

    logit P = constant + t min(|t|, most_t) sign(t) + margin l(nats ahead)
    l(n) = sign(n) ln(1 + |n| / near)

The three weights are fitted to kept evidence by `qcar-twin set-levels`; what every number is and where it comes
from stands in levels.toml. Once held-out recordings were opened for a name that changes their error by the factor r,

    logit P = constant + ... + held max(-1, min(-ln r / gain, 1))
"""

import dataclasses
import functools
import math
import tomllib
from pathlib import Path

from scipy.stats import chi2

FILE = Path(__file__).with_name("levels.toml")


@dataclasses.dataclass(frozen=True)
class Levels:
  """The numbers that decide what is claimed, and whether something is left.

  Attributes:
    constant, t, margin: weights of the logistic.
    held: what a name's log odds gain where it lowers the error on held-out recordings by `gain`, and lose where it
      raises it by as much.
    cap: nats that a block can bring to the decision, so that no single event decides.
    wide: the same for how much there is to explain at all, in caps.
    least_spread: least standard deviation of the blocks' gains, in caps: where every block brings the cap, t would be a
      number without meaning.
    most_t: held-out t beyond which more of it tells nothing.
    near: nats between two fits of a likelihood ratio of 20.
    claim: probability from which a name is claimed.
    gain: share that a name must take off the held-out error of some channel.
    sure: one-sided confidence that what it takes off is above zero.
    conflict: chance that any figure of a car lies that far from what was measured.
    family: chance that anything scanned on a data set without an effect gets beyond its level.
    draws: sign flips that the level is taken from.
    unusual: chance that a sensor of the kind is that far from having no bias.
    equivalent: held-out t of a claim over a rival below which the two can't be told apart.
    form: standard deviation of a claimed size for the formula's own error, as a share of it.
    chance: probability under noise from which on smooth structure of a channel is none.
    material: share of a channel's spread from which on it matters: with quiet sensors the twin's own simplifications
      become visible.
    rhythm: probability under a smooth spectrum from which on a line is none.
    bursts: odds that an error falls into the few strongest moments from which on they are bursts.
    error: multiple of a sensor's noise while driving from which on an error where nothing was fitted is more than that.
    good: multiple of the sensors' noise up to which an error is what the sensors leave.
    fast: quantile of a recording's speeds that stands for its fast end.
    short: share of it that a twin may miss.
    remains: part of the recalibrated twin's own leftover that may remain beside a right name: a formula right in kind
      is not right in every detail.
    doubt: what a probability is multiplied by where more remains.
  """

  constant: float
  t: float
  margin: float
  held: float
  cap: float
  wide: float
  least_spread: float
  most_t: float
  near: float
  claim: float
  gain: float
  sure: float
  conflict: float
  family: float
  draws: float
  unusual: float
  equivalent: float
  form: float
  chance: float
  material: float
  rhythm: float
  bursts: float
  error: float
  good: float
  fast: float
  short: float
  remains: float
  doubt: float

  def figures(self, t: float, margin: float) -> tuple[float, float]:
    """What the weights t and margin multiply."""
    return max(-self.most_t, min(t, self.most_t)), math.copysign(math.log1p(abs(margin) / self.near), margin)

  def usual_reach(self, count: int) -> float:
    """How far biases of one sensor lie from none, in usual deviations of all together, but with chance `unusual`."""
    return math.sqrt(float(chi2.isf(self.unusual, count))) if count else math.inf

  def probability(self, t: float, margin: float) -> float:
    """That a name is right.

    Args:
      t: held-out gain over its standard error, with what the priors gain.
      margin: nats by which it fits better than nothing, or than the best other name in its place, in its priors, too.
    """
    far, ahead = self.figures(t, margin)
    return 1.0 / (1.0 + math.exp(-self.constant - (self.t * far + self.margin * ahead)))

  def change(self, ratio: float) -> float:
    """What the weight `held` multiplies, where a name changes the error on held-out recordings by a factor."""
    return max(-1.0, min(-math.log(ratio) / self.gain, 1.0)) if 0.0 < ratio < math.inf else -1.0

  def after_holdout(self, probability: float, ratio: float | None) -> float:
    """A probability once it is seen by which factor the name changes the error on held-out recordings; as it is where
    they were not opened for it, None."""
    if ratio is None:
      return probability
    odds = probability * math.exp(self.held * self.change(ratio))
    return odds / (odds + 1.0 - probability)


def read_levels(file: Path = FILE) -> Levels:
  """The levels of a file.

  Raises:
    ValueError: a level is missing, unknown, or without a unit or a source.
  """
  table = tomllib.loads(file.read_text(encoding="utf-8"))
  known = {f.name for f in dataclasses.fields(Levels)}
  if set(table) != known:
    raise ValueError(f"{file.name}: levels must be {', '.join(sorted(known))}; it has {', '.join(sorted(table))}")
  for name, entry in table.items():
    for said, cure in (("source", "say where its value comes from"), ("unit", 'say what it is in, "-" for a number')):
      if not entry.get(said):
        raise ValueError(f"{file.name}: level '{name}' has no {said}; {cure}")
  return Levels(**{name: float(entry["value"]) for name, entry in table.items()})


@functools.cache
def usual_levels() -> Levels:
  """Those of levels.toml."""
  return read_levels()
