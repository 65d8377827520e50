"""Which twin a diagnosis writes as twin.toml: never one that predicts worse than a simpler one.

The repaired twin is written unless, on recordings that took no part in the fit, it errs more than the recalibrated one,
all channels together or surely in one of them, or does not reach the speeds that were logged (`decision.veto`). Free
curves have no physics behind them that speaks for driving unlike the fitted one. They are written only where the same
holds of them, where they err less than the repaired twin, and where no channel loses more by them than all gain on
average. Held-out recordings only forbid a twin here; which one is tried first is not theirs to say.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.decision.veto import falls_short, surely_worse
from calibration.diagnosis.holdout_errors import ChannelFit, change, channel_fit, held_out_error
from calibration.diagnosis.outcome import Diagnosis, Outcome
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.noise_floor import driving_noise, residual_floor
from calibration.fitting.observations import Observations, observe
from calibration.fitting.residual_channels import RESIDUALS
from calibration.fitting.windows import Cut
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]
# that tell how fast a car was, best first
_SPEEDS = ("motor_speed", "speed", "pose_speed", "path_speed", "pose_forward", "path_forward")
JUDGING = {"validate": "validation", "holdout": "held-out"}


@dataclasses.dataclass(frozen=True)
class Written:
  """A twin as a file holds it.

  Attributes:
    twin, theta: the car and its parameters, (P,).
    note: first line of the file.
    command_shift: control periods by which logged commands act later than they are logged, where it is driven.
  """

  twin: Twin
  theta: Array
  note: str
  command_shift: int


def worse_on(diagnosis: Diagnosis) -> tuple[str, ...]:
  """Kinds of recordings on which the repaired twin errs more than the recalibrated one, all channels together."""
  fits = {name: getattr(diagnosis, role) for role, name in JUDGING.items()}
  return tuple(name for name, kept in fits.items() if change(kept) > 1.0)


def objections(diagnosis: Diagnosis) -> tuple[str, ...]:
  """What speaks against the repaired twin in the recalibrated one's place, each a clause; none where it is written."""
  worse = worse_on(diagnosis)
  said = [f"the repaired twin's errors on {' and '.join(worse)} recordings are larger"] if worse else []
  said += [c for role in JUDGING for c in worse_clauses(role, getattr(diagnosis, role))]
  replay = diagnosis.replay
  if replay is not None and diagnosis.decision.mechanisms:
    said += slow_clauses(replay.observations, replay.before, replay.after)
  return tuple(said)


def worse_clauses(role: str, fits: Mapping[str, ChannelFit]) -> list[str]:
  """Channels in which a twin surely errs more than the recalibrated one, each a clause."""
  rows = surely_worse((held_out_error(role, name, fit) for name, fit in fits.items()), usual_levels())
  more = lambda e: f"{100.0 * (e.after / e.before - 1.0):.0f} %"
  return [f"on {JUDGING[role]} recordings {RESIDUALS[e.channel].words} errs by {more(e)} more" for e in rows]


def slow_clauses(observations: Observations, before: Array, after: Array) -> list[str]:
  """Whether a twin misses the speeds that were logged, a clause or none.

  Args:
    observations: what was logged, M values.
    before, after: predicted minus measured of the recalibrated twin and of the one that is judged, (M,).
  """
  channel, levels = next((c for c in _SPEEDS if c in observations.present), None), usual_levels()
  if channel is None:
    return []
  rows = observations.select(channel)
  logged = observations.measured[rows]
  fast = lambda values: float(np.quantile(np.abs(values), levels.fast))
  reached, most = fast(logged + after[rows]), fast(logged)
  if not falls_short(reached, most, fast(logged + before[rows]), levels):
    return []
  said = RESIDUALS[channel]
  return [f"the fast end of {said.words} is {reached:.3g} {said.symbol} where {most:.3g} were logged"]


def shipped(outcome: Outcome) -> Written:
  """The repaired twin; the recalibrated one where nothing was added, or the repaired one predicts worse."""
  d, against = outcome.diagnosis, objections(outcome.diagnosis)
  if not d.decision.mechanisms:
    return recalibrated(outcome)
  claims = ", ".join(c.mechanism for c in d.decision.claims) or "no mechanism claimed"
  note = f"recalibrated on {d.dataset}; {'; '.join(against)}" if against else f"repaired on {d.dataset}: {claims}"
  return Written(outcome.twin, outcome.before if against else outcome.after, note, outcome.cut.command_shift)


def recalibrated(outcome: Outcome) -> Written:
  """The twin before anything was added."""
  note = f"recalibrated on {outcome.diagnosis.dataset}, nothing added"
  return Written(outcome.twin, outcome.before, note, outcome.cut.command_shift)


def kind(diagnosis: Diagnosis) -> str:
  """What `shipped` is, a word: "repaired" or "recalibrated"."""
  return "repaired" if diagnosis.decision.mechanisms and not objections(diagnosis) else "recalibrated"


def warning(diagnosis: Diagnosis) -> str:
  """Why the repaired twin is not the one that is written; "" where it is."""
  against = objections(diagnosis)
  return f"twin.toml is the recalibrated twin: {'; '.join(against)}." if against else ""


@dataclasses.dataclass(frozen=True)
class Judged:
  """Two twins on the same recordings, both driven by MuJoCo.

  Attributes:
    fits: errors by channel, before of the first twin and after of the second.
    slow: whether the second misses speeds that were logged, a clause or none.
  """

  fits: Mapping[str, ChannelFit]
  slow: tuple[str, ...] = ()

  @property
  def losing(self) -> tuple[str, ...]:
    """Channels that speak against the second twin in the first one's place; none where it predicts better.

    With r_c a channel's ratio of errors, second over first, and r their geometric mean, a channel speaks against the
    second twin where it loses more than all gain on average: the lower bound of r_c (95 %, by blocks of driving) is
    above 1 / r. Where r is above 1, every channel with r_c above 1 does.
    """
    mean = change(self.fits)
    if mean > 1.0:
      return tuple(name for name, fit in self.fits.items() if fit.after > fit.before)
    return tuple(name for name, fit in self.fits.items() if 1.0 + fit.ci95[0] > 1.0 / mean)


def judge(first: Written, second: Written, recordings: Sequence[Recording]) -> Judged:
  """Two twins as they would be written, on recordings that took no part."""
  if not recordings:
    return Judged({})
  observed, errors = zip(*(_driven(written, recordings) for written in (first, second)), strict=True)
  floors = {}, residual_floor(driving_noise(recordings))
  random = np.random.default_rng(0)
  fits = {n: channel_fit(observed[0], np.stack(errors), n, floors, random) for n in observed[0].present}
  return Judged(fits, tuple(slow_clauses(observed[0], *errors)))


def _driven(written: Written, recordings: Sequence[Recording]) -> tuple[Observations, Array]:
  cut = Cut(command_shift=written.command_shift, most=LONGEST)
  observations = observe(recordings, written.twin.vehicle, cut)
  prediction = written.twin.rollout(written.theta[None], observations.stretches.segments)
  return observations, observations.predict(prediction)[0] - observations.measured
