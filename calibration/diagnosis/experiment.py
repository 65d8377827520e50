"""What to drive next: the manoeuvre that would best tell the claim from the rival that is closest to it.

Both fitted models drive every manoeuvre of a small library, made of speeds and steering angles the recordings
already hold. What the rival could still bend to imitate, within what the recordings say of its parameters, does not
count:

  nats = (d'd - d'J (H + J'J)^-1 J'd) / 2

with d the whitened difference of the two predictions, J the rival's Jacobian on the manoeuvre and H the posterior
curvature it has from the recordings.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate, difference_step
from calibration.diagnosis.decision.claims import Claim
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.pool import Pool
from calibration.fitting.likelihood import Problem, Weighting, correlation_length
from calibration.fitting.observations import CHANNELS, Observations, observe
from calibration.fitting.optimiser import inverse_curvature
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.plant import signal_index
from qcar_twin.recordings.recording import Recording, Stream

Array = NDArray[np.float64]
NOTHING = "no_mismatch"  # the rival of a mechanism that is possible but not claimed
_SURE = 0.8  # a claim at least so probable, without equivalents, needs no further driving
_LASTS, _RATE = 8.0, 100.0  # s of a manoeuvre, Hz of commands and channels


@dataclasses.dataclass(frozen=True)
class DrivenRange:
  """What was driven, and so can be driven again: the drive's command per m/s, a slow and a fast speed, m/s, a wide
  angle, rad; `unit` of the command."""

  command: float
  slow: float
  fast: float
  angle: float
  unit: str = "V"


@dataclasses.dataclass(frozen=True)
class Manoeuvre:
  """What to do, in words, and as the drive's command in its unit and steering command, rad, at 100 Hz, (T, 2)."""

  about: str
  commands: Array


def next_experiment(pool: Pool, decision: Decision) -> dict[str, object] | None:
  """Manoeuvre, what it separates and the nats it is predicted to bring; None where nothing is left to separate.

  A manoeuvre on which one of the two flies apart tells nothing; None, too, where all are such.
  """
  pair = to_separate(pool, decision)
  if pair is None:
    return None
  names, model, rival = pair
  library = manoeuvres(reach(pool))
  worth = predicted_nats(pool.problem, model, rival, library)
  if not np.isfinite(worth).any():
    return None
  best = int(np.nanargmax(np.where(np.isfinite(worth), worth, np.nan)))
  return {"manoeuvre": library[best].about, "separates": list(names), "predicted_nats": float(worth[best])}


def to_separate(pool: Pool, decision: Decision) -> tuple[tuple[str, str], Candidate, Candidate] | None:
  """The least certain name, its closest rival and the models of both; None where the names are certain."""
  for claim in sorted(filter(_doubtful, decision.claims), key=lambda c: c.probability):
    others = frozenset(decision.mechanisms) - {claim.mechanism}
    fitted = [name for name, _ in claim.alternatives if others | {name} in pool.models]
    if claim.mechanism in decision.mechanisms and fitted:
      return (claim.mechanism, fitted[0]), pool.model(decision.mechanisms), pool.models[others | {fitted[0]}]
  if decision.possible and not decision.claims:
    name = decision.possible[0]
    return (name, NOTHING), pool.models[frozenset([name])], pool.base
  return None


def _doubtful(claim: Claim) -> bool:
  return claim.probability < _SURE or bool(claim.indistinguishable_from)


def reach(pool: Pool) -> DrivenRange:
  """Speeds, angles and the drive's command per m/s the recordings hold, as the recalibrated twin drives them."""
  segments = pool.problem.observations.stretches.segments
  velocity = pool.problem.exact.predict(pool.base.theta[None]).signals[0, :, 1:, signal_index("velocity_x")]
  driven = np.arange(velocity.shape[1]) < segments.steps[:, None]
  v, command, angle = velocity[driven], segments.commands[..., 0][driven], np.abs(segments.commands[..., 1][driven])
  fast = max(float(np.quantile(np.abs(v), 0.98)), 0.3)
  gain = float(np.sum(command * v) / max(float(np.sum(v**2)), 1e-6))
  widest = float(np.clip(np.quantile(angle, 0.98), 0.1, 0.5))
  return DrivenRange(gain, max(0.25, 0.35 * fast), fast, widest, pool.problem.twin.vehicle.motor.unit)


def manoeuvres(reach: DrivenRange) -> list[Manoeuvre]:
  """The library: turns at two speeds, straight drives, and both together."""
  t = np.arange(0.0, _LASTS - 1e-9, 1.0 / _RATE)
  found: list[Manoeuvre] = []
  still = np.zeros_like(t)

  def add(about: str, speed: Array | float, steering: Array) -> None:
    command = np.broadcast_to(np.asarray(speed) * reach.command, t.shape)
    found.append(Manoeuvre(about, np.column_stack([command, steering])))

  unit = {"-": "of full duty"}.get(reach.unit, reach.unit)
  said = lambda v: f"{v:.2g} m/s ({v * reach.command:.2g} {unit})"
  slow, fast = said(reach.slow), said(reach.fast)
  for v, angle, at in ((reach.slow, reach.angle, slow), (reach.fast, 0.5 * reach.angle, fast)):
    add(f"circles at {at}, 4 s left and 4 s right with {angle:.2g} rad", v, angle * _square(t, 4.0))
    add(f"steering steps of ±{angle:.2g} rad every second at {at}", v, angle * _square(t, 1.0))
    add(f"a steering sweep from 0.2 to 3 Hz with ±{angle:.2g} rad at {at}", v, angle * np.sin(_sweep(t)))
  on_and_off = np.where(t % 4.0 < 2.0, reach.fast, 0.0)
  half = 0.5 * reach.angle
  triangle = 2.0 * np.abs(2.0 * ((t / 4.0) % 1.0) - 1.0) - 1.0
  add(f"a slow triangle of the steering to ±{reach.angle:.2g} rad at {slow}", reach.slow, reach.angle * triangle)
  add(f"straight, 2 s at {fast} and 2 s coasting, twice", on_and_off, still)
  add(f"{half:.2g} rad of steering, 2 s at {fast} and 2 s coasting, twice", on_and_off, half + still)
  add(f"straight, {fast} forward and backward for 1 s each", reach.fast * _square(t, 1.0), still)
  add(f"straight, between {slow} and {fast} every second", np.where(t % 2.0 < 1.0, reach.slow, reach.fast), still)
  return found


def _square(t: Array, half_period: float) -> Array:
  return np.where(t % (2.0 * half_period) < half_period, 1.0, -1.0)


def _sweep(t: Array) -> Array:
  """Phase of a sweep whose frequency grows exponentially from 0.2 to 3 Hz over a manoeuvre, rad."""
  growth = np.log(3.0 / 0.2) / _LASTS
  return 2.0 * np.pi * 0.2 * np.expm1(growth * t) / growth


def predicted_nats(problem: Problem, model: Candidate, rival: Candidate, library: Sequence[Manoeuvre]) -> Array:
  """Evidence each manoeuvre is expected to bring for a model over its rival, nats, (len(library),)."""
  planned = _planned(problem.observations, problem, library)
  steps = np.array([difference_step(rival, i) for i in range(len(rival.free))])
  moved = problem.embed(rival.free.names, rival.values + np.diag(steps), rival.theta)
  segments = dataclasses.replace(planned.stretches.segments, pose=None, wheel_angle=None)
  thetas = np.vstack([model.theta, rival.theta, moved])
  predicted = planned.predict(problem.twin.rollout(thetas, segments)) * _scale(problem, planned)
  difference, jacobian = predicted[0] - predicted[1], ((predicted[2:] - predicted[1]) / steps[:, None]).T
  rows = [planned.recording == k for k in range(len(library))]
  return np.array([_unimitated(difference[r], jacobian[r], rival) for r in rows])


def _unimitated(difference: Array, jacobian: Array, rival: Candidate) -> float:
  """Half the squared difference that is left when the rival bends as far as its recordings let it."""
  pull = jacobian.T @ difference
  inverse = inverse_curvature(rival.curvature + jacobian.T @ jacobian, rival.free)
  return 0.5 * float(difference @ difference - pull @ inverse @ pull)


def _planned(observations: Observations, problem: Problem, library: Sequence[Manoeuvre]) -> Observations:
  """Where the channels the recordings hold would be seen on each manoeuvre, started at rest."""
  commands = np.arange(0.0, _LASTS - 1e-9, 1.0 / _RATE)
  sampled = np.arange(0.0, _LASTS + 1e-9, 1.0 / _RATE)
  names = dict.fromkeys(needed for name in observations.present for needed in RESIDUALS[name].needs)
  recordings = []
  for k, item in enumerate(library):
    streams = {name: Stream(sampled, np.zeros_like(sampled)) for name in names}
    for column, name in enumerate(problem.twin.vehicle.commands):
      streams[name] = Stream(commands, item.commands[:, column])
    recordings.append(Recording(str(k), streams))
  return observe(recordings, problem.twin.vehicle, horizon=observations.horizon)


def _scale(problem: Problem, planned: Observations) -> Array:
  """Factor that turns the channels' units into nats, with the deviations the recordings were judged by, (M,)."""
  correlation = np.ones(len(CHANNELS))
  for index in np.unique(planned.channel):
    correlation[index] = correlation_length(planned, np.flatnonzero(planned.channel == index))
  return Weighting(problem.weighting.std, correlation, np.ones(len(planned))).scale(planned.channel)
