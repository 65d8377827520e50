"""What a diagnosis shows by driving: the film of the worst stretch, and the curves of the repaired car."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.experiment import reach
from calibration.diagnosis.outcome import Outcome
from calibration.diagnosis.report.curves import Curve, identified_curves
from calibration.fitting.observations import CHANNELS, Observations
from qcar_twin.extras import MissingExtra
from qcar_twin.pages import Clip
from qcar_twin.plant import POSE, SIGNALS, VELOCITY, Prediction, signal_index
from qcar_twin.plotting import BEFORE, TWIN
from qcar_twin.rendering.clip import comparison_film
from qcar_twin.rendering.film import RenderingUnavailable

Array = NDArray[np.float64]

_LASTS = 4.0  # s of the film, from the start of a simulated stretch: the cars set out together
_SHORTEST = 1.0  # s


@dataclasses.dataclass(frozen=True)
class Demonstration:
  """What was driven to be shown.

  Attributes:
    clip: the film; None where `no_film` says why.
    curves: of the nominal car, the recalibrated and the repaired twin.
  """

  clip: Clip | None = None
  no_film: str = ""
  curves: tuple[Curve, ...] = ()


NOTHING_SHOWN = Demonstration()


def demonstrate(outcome: Outcome) -> Demonstration:
  """Drive the repaired twin for its curves, and film the worst stretch."""
  pool = outcome.diagnosis.pool
  segments = pool.problem.observations.stretches.segments
  driven = np.arange(segments.commands.shape[1]) < segments.steps[:, None]
  thetas = {"nominal": outcome.twin.parameters.nominal, "before": outcome.before}
  if outcome.diagnosis.decision.mechanisms:
    thetas["twin"] = outcome.after
  curves = identified_curves(outcome.twin, thetas, reach(pool), segments.commands[driven])
  clip, why = _film(outcome)
  return Demonstration(clip, why, tuple(curves))


def worst_stretch(observations: Observations, weight: Array) -> int | None:
  """The simulated stretch whose first seconds hold most weight, (M,); None where no pose was measured."""
  segments = observations.stretches.segments
  if segments.pose is None:
    return None
  until = segments.offset[observations.stretch] + _LASTS
  early = observations.time <= until
  sums = np.bincount(observations.stretch[early], weight[early], len(segments))
  posed = np.isfinite(segments.pose).all(axis=(1, 2)) & (segments.steps * segments.period >= _SHORTEST)
  if not posed.any():
    return None
  return int(np.argmax(np.where(posed, sums, -np.inf)))


def _film(outcome: Outcome) -> tuple[Clip | None, str]:
  d = outcome.diagnosis
  observations, weight, whose = _to_film(outcome)
  worst = worst_stretch(observations, weight)
  if worst is None:
    return None, "There is no film: where the car was is not in these recordings (pose_x, pose_y, pose_yaw)."
  segments = observations.stretches.segments
  part = segments[worst : worst + 1]
  steps = int(min(part.steps[0], round(_LASTS / part.period)))
  repaired = bool(d.decision.mechanisms)
  thetas = np.stack([outcome.before, outcome.after] if repaired else [outcome.before])
  driven = outcome.twin.rollout(thetas, part)
  solid = recorded_signals(observations, worst, driven)[:steps]
  where = f"{part.recording[0]}, from {part.offset[0]:.1f} s"
  ghosts = [(f"{where}\nghost: recalibrated twin", BEFORE, driven.signals[0, 0, :steps])]
  if repaired:
    ghosts.append((f"{where}\nghost: repaired twin", TWIN, driven.signals[1, 0, :steps]))
  try:
    film, still = comparison_film(solid, ghosts, part.period, outcome.twin.vehicle)
  except (RenderingUnavailable, MissingExtra) as error:
    return None, f"There is no film: {error}."
  then = ", then of the repaired twin (blue)" if repaired else ""
  caption = (
    f"The film opens where car and recalibrated twin are apart, then runs from the start: {where} ({whose}). The solid"
    " car is the recorded one. The translucent car is driven by the same commands from the same start: first that of"
    f" the recalibrated twin (red){then}."
  )
  return Clip(film, caption, still), ""


def _to_film(outcome: Outcome) -> tuple[Observations, Array, str]:
  """Observations to choose from, how far the twins part at each value in multiples of sensor noise, and whose.

  Held-out or validation recordings where they hold a pose, else those that were fitted.
  """
  d = outcome.diagnosis
  if d.replay is not None and d.replay.observations.stretches.segments.pose is not None:
    fits, whose = (d.holdout, "held-out") if d.holdout else (d.validate, "validation")
    noise = np.array([fits[name].noise if name in fits else np.inf for name in CHANNELS])
    noise = np.where(noise > 0.0, noise, np.inf)[d.replay.observations.channel]
    repaired = bool(d.decision.mechanisms)
    apart = d.replay.after - d.replay.before if repaired else d.replay.before
    return d.replay.observations, np.square(apart / noise), whose
  return d.pool.problem.observations, d.location.evidence, "fitted"


def recorded_signals(observations: Observations, stretch: int, driven: Prediction) -> Array:
  """Rows of plant.SIGNALS, (T + 1, 10), of the recorded car in one stretch; angle of the wheels as simulated."""
  segments = observations.stretches.segments
  assert segments.pose is not None
  pose = segments.pose[stretch]
  signals = np.zeros((len(pose), len(SIGNALS)))
  signals[:, POSE] = pose
  forward, left = np.gradient(pose[:, 0], segments.period), np.gradient(pose[:, 1], segments.period)
  cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
  signals[:, VELOCITY] = np.stack([cosine * forward + sine * left, cosine * left - sine * forward], axis=-1)
  steering = signal_index("steering_angle")
  signals[:, steering] = driven.signals[-1, 0, :, steering]
  return signals
