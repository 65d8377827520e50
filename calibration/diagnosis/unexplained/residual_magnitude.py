"""How much of the motion a model still gets wrong on recordings that were not fitted, after a name as before it.

A wrong name can take half of the error away and pass every test against the twin without it. What it leaves is then
far more than recordings without hidden effects leave, and that is asked here, of sizes and not of structure: a large
error need not follow anything that is measured.
"""

import dataclasses

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.pool import Pool

# Shares of a channel's spread, set by hand: of motor speed twice, of yaw rate three times what proving-ground sessions
# without effects leave at the most. Displacements are not asked: one slide of the car decides them.
LEVELS = {"motor_speed": 0.03, "speed": 0.05, "yaw_rate": 0.03}
_SCATTER = 3.0  # standard deviations by which the mean square of white noise may exceed its variance by chance
# in the channels' units; a smaller spread counts as this one: pushes of the road are no share of a turn hardly driven
_LEAST = {"motor_speed": 80.0, "speed": 0.4, "yaw_rate": 0.4}
_TELLING = 1.0 / 3.0  # of a channel's spread, that recordings which only judge must show to be asked alone


@dataclasses.dataclass(frozen=True)
class Missed:
  """What a model gets wrong of one channel.

  Attributes:
    channel: a measured one, of LEVELS.
    share: RMS error beyond the sensor's noise over the standard deviation of what the channel measured.
    level: share that recordings without hidden effects stay below.
  """

  channel: str
  share: float
  level: float

  @property
  def strength(self) -> float:
    """In units of its level."""
    return self.share / self.level

  @property
  def sentence(self) -> str:
    """For a reader who knows cars and no statistics."""
    return (
      f"The twin still errs by {100 * self.share:.1f} % of what {self.channel} varies; "
      f"without hidden effects it is less than {100 * self.level:.1f} %."
    )


def worst_relative_error(model: Candidate, pool: Pool) -> Missed | None:
  """The channel a model misses most, in units of its level; None where no channel of LEVELS was measured.

  Recordings that only judge are asked; all, where there are none or where those hardly move the channel.
  """
  observations = pool.problem.observations
  error = model.residual / pool.problem.whiten(np.ones(len(observations)))
  judging = np.arange(len(observations)) >= model.n_train
  found = []
  for channel in (c for c in LEVELS if c in observations.present):
    rows = observations.select(channel)
    whole = float(np.std(observations.measured[rows]))
    spread = max(whole, _LEAST[channel])
    telling = (rows & judging).any() and np.std(observations.measured[rows & judging]) >= _TELLING * whole
    asked = rows & judging if telling else rows
    noise = pool.floor.get(channel, 0.0) ** 2
    excess = np.mean(np.square(error[asked])) - noise
    chance = _SCATTER * noise * np.sqrt(2.0 / np.count_nonzero(asked))
    level = float(np.hypot(LEVELS[channel], np.sqrt(chance) / spread))
    found.append(Missed(channel, float(np.sqrt(max(excess, 0.0))) / spread, level))
  return max(found, key=lambda m: m.strength, default=None)
