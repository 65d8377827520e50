"""Four independent signs that the recalibrated twin lacks something, before any physics is named.

Each detector gives one number, the level that recordings without any hidden effect stay below, and a
plain sentence. They need no simulation beyond one run of the fitted twin.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.circumstances import at_values, regressors
from calibration.diagnosis.score import groups_of
from calibration.fitting.likelihood import Problem
from calibration.fitting.noise import ChannelNoise
from calibration.fitting.observations import Observations
from calibration.fitting.recalibration import RecalibratedTwin
from calibration.fitting.residual_channels import displacement
from qcar_twin.plant import Prediction

Array = NDArray[np.float64]

# Set by hand: the largest statistics of proving-ground sessions without effects at three noise levels, rounded up;
# horizons: lower, since the exponent of a steady error is 1.
LEVELS = {"predictability": 0.25, "drift": 5.0, "priors": 9.0, "horizons": 0.98}
HORIZONS = (0.5, 2.0)  # s
_RIDGES = (0.03, 0.3, 3.0)  # of the power of each regressor; the best one counts
_SHIFT = 0.3  # of a parameter's scale: how far it may move from recording to recording in the drift test


@dataclasses.dataclass(frozen=True)
class Detector:
  """One sign of mismatch.

  Attributes:
    name: predictability, drift, priors or horizons.
    statistic: what was measured; 0 where the data do not allow it.
    threshold: the level above which it alarms.
    alarm: statistic > threshold.
    sentence: what it means, for a reader who knows cars and no statistics.
  """

  name: str
  statistic: float
  threshold: float
  alarm: bool
  sentence: str


@dataclasses.dataclass(frozen=True)
class Detection:
  """All detectors."""

  detectors: tuple[Detector, ...]

  @property
  def alarm(self) -> bool:
    return any(d.alarm for d in self.detectors)

  def __getitem__(self, name: str) -> Detector:
    return next(d for d in self.detectors if d.name == name)


def detect(
  baseline: RecalibratedTwin,
  base: Candidate,
  prediction: Prediction | None = None,
  problem: Problem | None = None,
  levels: Mapping[str, float] = LEVELS,
) -> Detection:
  """Ask the four detectors.

  Args:
    baseline: the recalibrated twin.
    base: the same as a candidate, with residual and Jacobian.
    prediction: its signals, one vector; simulated when absent.
    problem: the problem whose weights `base` carries now; the baseline's by default.
    levels: alarm level of each detector.
  """
  problem = problem or baseline.problem
  prediction = prediction or problem.exact.predict(base.theta[None])
  observations = problem.observations
  found = (
    predictability(base.residual, observations, prediction),
    drift(base, observations),
    prior_conflict(base),
    horizon_conflict(observations, prediction, baseline.passport),
  )
  return Detection(tuple(_judged(name, *parts, levels[name]) for name, parts in zip(LEVELS, found, strict=True)))


def _judged(name: str, statistic: float, sentences: tuple[str, str], level: float) -> Detector:
  alarm = bool(statistic > level)
  return Detector(name, float(statistic), level, alarm, sentences[0] if alarm else sentences[1])


def predictability(
  residual: Array, observations: Observations, prediction: Prediction
) -> tuple[float, tuple[str, str]]:
  """Share of a channel's squared residual that past commands and the state predict in recordings left out.

  Ridge regression per channel; each group of data is predicted from the others. The largest share
  over the channels counts, in [0, 1].
  """
  group = groups_of(observations)
  grid = regressors(observations, prediction)
  shares = {}
  for name in observations.present:
    rows = observations.select(name)
    shares[name] = predicted_share(at_values(grid, observations, name), residual[rows], group[rows])
  worst = max(shares, key=lambda n: shares[n])
  share = max(shares[worst], 0.0)
  alarm = (
    f"{100 * share:.0f} % of what the twin gets wrong in {worst} follows from commands and state, so it is no noise."
  )
  calm = f"At most {100 * share:.0f} % of what is left in any channel follows from commands and state ({worst})."
  return share, (alarm, calm)


def predicted_share(features: Array, target: Array, group: NDArray[np.int64]) -> float:
  """1 - error / power of ridge predictions of target (k,) from features (k, F), each group foretold by the others."""
  kinds = np.unique(group)
  power = float(target @ target)
  if len(kinds) < 2 or power <= 0:
    return 0.0
  members = [group == kind for kind in kinds]
  grams = np.stack([features[m].T @ features[m] for m in members])
  pulls = np.stack([features[m].T @ target[m] for m in members])
  gram, pull = grams.sum(axis=0), pulls.sum(axis=0)
  own_power = np.maximum(np.diag(gram), 1e-9 * np.trace(gram) + 1e-300)
  errors = np.zeros(len(_RIDGES))
  for k, ridge in enumerate(_RIDGES):
    for own, own_pull, member in zip(grams, pulls, members, strict=True):
      coefficients = np.linalg.solve(gram - own + ridge * np.diag(own_power), pull - own_pull)
      errors[k] += float(np.sum((target[member] - features[member] @ coefficients) ** 2))
  return 1.0 - float(errors.min()) / power


def drift(base: Candidate, observations: Observations) -> tuple[float, tuple[str, str]]:
  """How much each group of data pulls the parameters its own way: gain over what noise alone would gain.

  For each group one Gauss-Newton step from the common estimate, held by a prior of 0.3 scales:
  sum_g b_g' (H_g + L)^-1 b_g over its expectation sum_g tr((H_g + L)^-1 H_g); 1 for a perfect twin.
  """
  gained, expected = 0.0, 0.0
  group = groups_of(observations)
  scale = base.free.scale
  votes = []
  for kind in np.unique(group):
    rows = group == kind
    jacobian = base.jacobian[rows] * scale
    own, pull = jacobian.T @ jacobian, jacobian.T @ base.residual[rows]
    inverse = np.linalg.inv(own + np.eye(len(scale)) / _SHIFT**2)
    step, spread = -inverse @ pull, np.sqrt(np.maximum(np.diag(inverse @ own @ inverse), 1e-12))
    gained += float(pull @ inverse @ pull)
    expected += float(np.trace(inverse @ own))
    votes.append((step, step / spread, observations.names[observations.recording[rows][0]]))
  statistic = gained / max(expected, 1e-9)
  return statistic, _drift_sentences(base, votes, statistic)


def _drift_sentences(base: Candidate, votes: Sequence[tuple[Array, Array, str]], statistic: float) -> tuple[str, str]:
  strength = np.stack([v[1] for v in votes])
  worst = int(np.argmax(np.sum(strength**2, axis=0)))
  high, low = votes[int(np.argmax(strength[:, worst]))], votes[int(np.argmin(strength[:, worst]))]
  parameter = base.free.names[worst]
  percent = lambda v: 100 * v[0][worst] * base.free.scale[worst] / (abs(base.values[worst]) or 1.0)
  alarm = (
    f"No one {parameter} fits all recordings: '{high[2]}' pulls it by {percent(high):+.0f} %, "
    f"'{low[2]}' by {percent(low):+.0f} %, {statistic:.1f} times as hard as noise would."
  )
  return alarm, f"The recordings pull the parameters apart {statistic:.1f} times as hard as noise would; that is usual."


def prior_conflict(base: Candidate) -> tuple[float, tuple[str, str]]:
  """Largest shift of a measured parameter, in standard deviations of the shift a true value would make.

  The posterior mean of a Gaussian parameter scatters about the prior mean with variance prior - posterior.
  """
  z = prior_shifts(base)
  if not z:
    return 0.0, ("", "No parameter has a measured prior that the recordings could contradict.")
  worst = max(z, key=lambda n: abs(z[n]))
  i = base.free.index(worst)
  fitted, prior, unit = base.values[i], base.free.nominal[i], base.free[worst].unit
  unit = "" if unit == "-" else f" {unit}"
  text = f"{worst} was measured as {prior:.3g}{unit}, the recordings want {fitted:.3g}{unit}"
  alarm = f"{text}: {abs(z[worst]):.1f} standard deviations off, so it stands in for something else."
  return abs(z[worst]), (alarm, f"The measured parameters fit their measurements; the largest shift: {text}.")


def prior_shifts(base: Candidate) -> dict[str, float]:
  """(fitted - prior) / sqrt(prior variance - posterior variance) of parameters with a prior that the data inform.

  The difference counts as half the prior variance at least: the less the data say of a parameter, the farther the
  twin's own simplifications carry it, and the smaller is the deviation that a true shift would have.
  """
  out = {}
  for i, parameter in enumerate(base.free):
    if parameter.std is None or parameter.null is not None:  # a sensor's bias was never measured
      continue
    left = parameter.std**2 - base.std[i] ** 2
    if left > 0.05 * parameter.std**2:
      spread = np.sqrt(max(left, 0.5 * parameter.std**2))
      out[parameter.name] = float((base.values[i] - parameter.nominal) / spread)
  return out


def horizon_conflict(
  observations: Observations, prediction: Prediction, passport: Mapping[str, ChannelNoise]
) -> tuple[float, tuple[str, str]]:
  """How far the pose error grows from 0.5 s to 2 s: p in error ~ time^p, sensor noise subtracted.

  1/2 is what random pushes give, 1 a steady wrong velocity or turn, more an error that feeds itself. The
  largest over forward, left and turn.
  """
  names = ("pose_forward", "pose_left", "pose_turn")
  spreads = [pose_errors(observations, prediction, passport, horizon) for horizon in HORIZONS]
  exponents = {}
  for k, name in enumerate(names):
    short, long = (s[k] for s in spreads)
    if short > 0 and long > 0:
      exponents[name] = float(np.log(long / short) / np.log(HORIZONS[1] / HORIZONS[0]))
  if not exponents:
    return 0.0, ("", "Two horizons can't be compared: there is no pose, or its error is below its noise.")
  worst = max(exponents, key=lambda n: exponents[n])
  text = f"from {HORIZONS[0]:g} s to {HORIZONS[1]:g} s the error of {worst} grows like time^{exponents[worst]:.2f}"
  alarm = f"{text.capitalize()}: a systematic error, since random pushes would give time^0.5."
  return max(exponents[worst], 0.0), (alarm, f"{text.capitalize()}, no more than in sessions without hidden effects.")


def pose_errors(
  observations: Observations, prediction: Prediction, passport: Mapping[str, ChannelNoise], horizon: float
) -> Array:
  """RMS error of displacements over a horizon: forward, left [m], turn [rad], (3,), less the pose's noise, or 0."""
  segments = observations.stretches.segments
  if segments.pose is None or not {"pose_x", "pose_y", "pose_yaw"} <= passport.keys():
    return np.zeros(3)
  step = int(round(horizon / segments.period))
  pose, predicted = segments.pose, prediction.signals[0, :, :, :3]
  moved = displacement(pose[:, :-step], pose[:, step:])
  error = moved - displacement(predicted[:, :-step], predicted[:, step:])
  keep = _scored(observations)[:, :-step] & np.isfinite(error).all(axis=-1) & _scored(observations)[:, step:]
  if keep.sum() < 20:
    return np.zeros(3)
  # robust: one slide of the car must not decide
  variance = (1.4826 * np.median(np.abs(error[keep]), axis=0)) ** 2
  position = passport["pose_x"].std ** 2 + passport["pose_y"].std ** 2
  far = float(np.mean(moved[keep][:, 0] ** 2))
  heading = passport["pose_yaw"].std ** 2
  noise = np.array([position, position + heading * far, 2 * heading])
  return np.sqrt(np.maximum(variance - noise, 0.0))


def _scored(observations: Observations) -> NDArray[np.bool_]:
  """Grid points inside the scored part of each segment, (S, T + 1)."""
  stretches = observations.stretches
  segments = stretches.segments
  step = np.arange(segments.commands.shape[1] + 1)
  time = segments.offset[:, None] + segments.period * step
  inside = (time >= stretches.first[:, None] - 1e-9) & (time <= stretches.last[:, None] + 1e-9)
  return inside & (step <= segments.steps[:, None])
