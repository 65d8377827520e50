"""A log checked before anything is fitted to it: what spoils results, what may mislead one, what it can show."""

import dataclasses
import logging
import os
from typing import Any, Literal

from calibration.fitting.noise import ChannelNoise, noise_passport
from calibration.log_check.motions import Wheels, motions
from calibration.log_check.pairs import Comparison, compare
from calibration.log_check.shows import Shown, what_it_shows
from calibration.log_check.timing import Sampling, samplings
from calibration.progress import Progress, silent
from qcar_twin.recordings import dataset as dataset_module
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.vehicle.vehicle import Vehicle

Severity = Literal["spoils", "beware", "note"]
_PERIOD = 0.01  # s, of the twin's control: a lag below it is no finding
_SCALE = 0.01  # a sensor's usual tolerance of sensitivity; a scale within it is no finding
_CONTRARY, _ALIKE = -0.5, 0.8  # correlation of two sensors of one motion: contrary, and alike enough to be scaled
_FACTOR = 2.0  # between two sensors of one motion, from which a unit or a gear is wrong


@dataclasses.dataclass(frozen=True)
class Finding:
  """Something to know: `spoils` what is fitted, `beware`, or a `note`; channels it is about, and a sentence with the
  cure."""

  severity: Severity
  channels: tuple[str, ...]
  text: str


@dataclasses.dataclass(frozen=True)
class LogCheck:
  """The outcome of the check.

  Attributes:
    findings: worst first.
    comparisons: of sensors that measure one motion.
    noise: of a sample, by channel.
  """

  dataset: DataSet
  findings: tuple[Finding, ...]
  samplings: tuple[Sampling, ...]
  comparisons: tuple[Comparison, ...]
  shown: tuple[Shown, ...]
  noise: dict[str, ChannelNoise]

  def of(self, severity: Severity) -> tuple[Finding, ...]:
    return tuple(f for f in self.findings if f.severity == severity)

  @property
  def verdict(self) -> str:
    """The outcome in one sentence."""
    spoiling, warnings = self.of("spoils"), self.of("beware")
    if spoiling:
      return f"Not fit to be fitted as it is: {spoiling[0].text}"
    if len(warnings) > 0:
      count = f"{len(warnings)} warning{'s' if len(warnings) > 1 else ''}"
      return f"Fit to be used, with {count}, first: {warnings[0].text}"
    return "Fit to be used: nothing was found that would spoil a fit."

  def document(self) -> dict[str, Any]:
    """check.json; NaN becomes null."""
    return {
      "schema": 1,
      "dataset": self.dataset.name,
      "verdict": self.verdict,
      "findings": [dataclasses.asdict(f) for f in self.findings],
      "sampling": [dataclasses.asdict(s) for s in self.samplings],
      "noise": {name: dataclasses.asdict(n) for name, n in self.noise.items()},
      "comparisons": [_comparison(c) for c in self.comparisons],
      "shown": [{**dataclasses.asdict(s), "verdict": s.verdict} for s in self.shown],
    }


def load_to_check(folder: str | os.PathLike[str]) -> DataSet:
  """A data set whose warnings are not printed: a check says them among its findings, each kind once."""
  log = logging.getLogger(dataset_module.__name__)
  before, log.disabled = log.disabled, True
  try:
    return DataSet.load(folder)
  finally:
    log.disabled = before


def check_log(dataset: DataSet, progress: Progress = silent) -> LogCheck:
  """Check a data set that could be loaded; without a model of a car."""
  recordings = dataset.recordings
  progress("noise and timing")
  noise, sampled = noise_passport(recordings), samplings(recordings)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  wheels = Wheels.of(vehicle, recordings)
  compared = []
  for motion in motions(wheels, recordings):
    progress(f"two sensors of one motion: {motion.name}")
    compared.append(compare(motion, wheels, recordings, noise))
  shown = what_it_shows(vehicle, wheels, recordings)
  findings = [
    *(f for c in compared for f in _disagreements(c)),
    *(Finding("beware", (), warning) for warning in dataset.notices),
    *(f for s in sampled for f in _held(s)),
    *(Finding("note", (), f"{s.physics}: can't be told, no {s.takes}") for s in shown if s.verdict == "none"),
  ]
  order = ("spoils", "beware", "note")
  findings.sort(key=lambda f: order.index(f.severity))
  return LogCheck(dataset, tuple(findings), tuple(sampled), tuple(compared), tuple(shown), noise)


def heed(dataset: DataSet) -> tuple[str, ...]:
  """Warnings for every fit to a log: sensors of one motion that disagree, values that are held.

  Role "holdout" stays closed.

  Raises:
    RecordingError: two sensors contradict each other, so that a fit to both would mean nothing.
  """
  seen = tuple(r for r in dataset.recordings if r.role != "holdout")
  if not seen:
    return ()
  check = check_log(dataclasses.replace(dataset, recordings=seen))
  if spoiling := check.of("spoils"):
    raise RecordingError(f"data set '{dataset.name}': {spoiling[0].text}")
  return tuple(f.text for f in check.of("beware") if f.channels)


def _disagreements(c: Comparison) -> list[Finding]:
  """Of two sensors of one motion."""
  channels = (*c.motion.compared, *c.motion.reference)
  names = f"{_list(c.motion.compared)} and {_list(c.motion.reference)}"
  if c.why_not:
    return []
  if c.correlation < _CONTRARY:
    cure = "one of them has the wrong sign; set scale = -1 on it in [channels]"
    return [Finding("spoils", channels, f"{names} say the contrary of {c.motion.name}: {cure}")]
  steered = c.motion.reference[0] == "steering_command"
  if c.correlation > _ALIKE and not steered and not 1.0 / _FACTOR < c.scale.value < _FACTOR:
    cure = "a unit, a gear ratio or a wheel radius is wrong; correct scale in [channels], or [vehicle]"
    return [Finding("spoils", channels, f"{names} differ {c.scale.value:.3g}-fold in {c.motion.name}: {cure}")]
  if not c.motion.kinematic:
    return []
  findings: list[Finding] = []
  sensor, other = c.motion.compared[0], _list(c.motion.reference)
  if c.lag.beyond(0.0) and abs(c.lag.value) > _PERIOD:
    late = "late" if c.lag.value > 0.0 else "early"
    said = f"{sensor} is {1e3 * abs(c.lag.value):.0f} ± {1e3 * c.lag.std:.0f} ms {late} against {other}"
    findings.append(Finding("beware", channels, f"{said}; start states and lags that are fitted depend on it"))
  if c.scale.beyond(1.0) and abs(c.scale.value - 1.0) > _SCALE:
    said = f"{sensor} reads {100 * (c.scale.value - 1.0):+.1f} ± {100 * c.scale.std:.1f} % against {other}"
    findings.append(Finding("beware", channels, f"{said}; a scale, a gear ratio or a radius is off"))
  return findings


def _held(s: Sampling) -> list[Finding]:
  if s.held < 1.5:
    return []
  cure = f"set hold = true on {s.channel} in [channels], or what is fitted counts each value {s.held:.0f} times"
  return [Finding("beware", (s.channel,), f"{s.channel} is new {s.publishes:.3g} times a second only: {cure}")]


def _comparison(c: Comparison) -> dict[str, Any]:
  estimate = lambda e: {"value": e.value, "std": e.std}
  return {
    "motion": c.motion.name,
    "compared": list(c.motion.compared),
    "reference": list(c.motion.reference),
    "unit": c.motion.unit,
    "kinematic": c.motion.kinematic,
    **{name: estimate(getattr(c, name)) for name in ("lag", "scale", "bias")},
    **{name: getattr(c, name) for name in ("correlation", "residual", "noise", "seconds", "why_not")},
    "regimes": {name: estimate(e) for name, e in c.regimes.items()},
  }


def _list(names: tuple[str, ...]) -> str:
  return " and ".join(names) if len(names) < 3 else f"{', '.join(names[:-1])} and {names[-1]}"
