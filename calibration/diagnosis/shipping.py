"""Which twin a diagnosis writes as twin.toml: never one that predicts worse than a simpler one.

The repaired twin is written unless it errs more than the recalibrated one, all channels together, on recordings that
took no part in the fit. Free curves have no physics behind them that speaks for driving unlike the fitted one: they are
written only where they err less, and where no channel loses more by them than all gain on average.
Held-out recordings only forbid a twin here; which one is tried first is not theirs to say.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.holdout_errors import ChannelFit, channel_fit, ratio
from calibration.diagnosis.outcome import Diagnosis, Outcome
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.noise_floor import driving_noise, residual_floor
from calibration.fitting.observations import Observations, observe
from calibration.fitting.windows import Cut
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]
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
  return tuple(name for name, kept in fits.items() if _ratio(kept) > 1.0)


def shipped(outcome: Outcome) -> Written:
  """The repaired twin; the recalibrated one where the repaired one predicts worse."""
  d, worse = outcome.diagnosis, worse_on(outcome.diagnosis)
  claims = ", ".join(c.mechanism for c in d.decision.claims) or "no mechanism added"
  note = f"recalibrated on {d.dataset}; {_larger(worse)}" if worse else f"repaired on {d.dataset}: {claims}"
  return Written(outcome.twin, outcome.before if worse else outcome.after, note, outcome.cut.command_shift)


def kind(diagnosis: Diagnosis) -> str:
  """What `shipped` is, a word: "repaired" or "recalibrated"."""
  return "recalibrated" if worse_on(diagnosis) else "repaired"


def warning(diagnosis: Diagnosis) -> str:
  """Why the repaired twin is not the one that is written; "" where it is."""
  worse = worse_on(diagnosis)
  return f"twin.toml is the recalibrated twin: {_larger(worse)}." if worse else ""


def worse_channels(first: Written, second: Written, recordings: Sequence[Recording]) -> tuple[str, ...]:
  """Channels that speak against the second twin in the first one's place; none where it predicts better.

  Both are driven by MuJoCo over the same recordings. With r_c a channel's ratio of errors, second over first, and r
  their geometric mean, a channel speaks against the second twin where it loses more than all gain on average: the lower
  bound of r_c (95 %, by blocks of driving) is above 1 / r. Where r is above 1, every channel with r_c above 1 does.
  """
  if not recordings:
    return ()
  observed, errors = zip(*(_driven(written, recordings) for written in (first, second)), strict=True)
  floors = {}, residual_floor(driving_noise(recordings))
  random = np.random.default_rng(0)
  fits = {n: channel_fit(observed[0], np.stack(errors), n, floors, random) for n in observed[0].present}
  mean = _ratio(fits)
  if mean > 1.0:
    return tuple(name for name, fit in fits.items() if fit.after > fit.before)
  return tuple(name for name, fit in fits.items() if 1.0 + fit.ci95[0] > 1.0 / mean)


def _driven(written: Written, recordings: Sequence[Recording]) -> tuple[Observations, Array]:
  cut = Cut(command_shift=written.command_shift, most=LONGEST)
  observations = observe(recordings, written.twin.vehicle, cut)
  prediction = written.twin.rollout(written.theta[None], observations.stretches.segments)
  return observations, observations.predict(prediction)[0] - observations.measured


def _ratio(fits: Mapping[str, ChannelFit]) -> float:
  return ratio({name: fit.after for name, fit in fits.items()}, {name: fit.before for name, fit in fits.items()})


def _larger(worse: Sequence[str]) -> str:
  return f"the repaired twin's errors on {' and '.join(worse)} recordings are larger"
