"""A log checked before anything is fitted to it: what spoils results, what may mislead one, what it can show."""

import dataclasses
import logging
import math
import os
from collections.abc import Sequence
from typing import Any

from calibration.fitting.noise import ChannelNoise, noise_models
from calibration.fitting.windows import DEFAULT_CUT
from calibration.log_check.causes import LATE
from calibration.log_check.commands import (
  PARKED,
  command_findings,
  direction_findings,
  drive_findings,
  parked_findings,
  size_findings,
)
from calibration.log_check.disagreements import Finding, Severity, disagreements, lag_findings, scale_findings
from calibration.log_check.motions import Wheels, motions
from calibration.log_check.odd_files import TwoGroups, odd_file_findings
from calibration.log_check.pairs import Comparison, compare
from calibration.log_check.pose_point import mirrored_findings, pose_point_findings, upside_down_findings
from calibration.log_check.shows import Shown, what_it_shows
from calibration.log_check.timing import Sampling, samplings
from calibration.log_check.unjudged import (
  clock_findings,
  grip_findings,
  guessed_findings,
  lonely_findings,
  loose_findings,
)
from calibration.progress import Progress, silent
from qcar_twin.recordings import dataset as dataset_module
from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.checks.steered import turns_unsteered
from qcar_twin.recordings.completed import UNJUDGED
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, RecordingError
from qcar_twin.vehicle.vehicle import Vehicle


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
    if warnings and warnings[0].text.startswith(PARKED):
      return f"Nothing to be fitted: {warnings[0].text}"
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
  noise, sampled = noise_models(recordings), samplings(recordings)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  wheels = Wheels.of(vehicle, recordings)
  compared = []
  for motion in motions(wheels, recordings):
    progress(f"two sensors of one motion: {motion.name}")
    compared.append(compare(motion, wheels, recordings, noise))
  shown = what_it_shows(vehicle, wheels, recordings)
  acted = parked_findings(wheels, recordings)
  acted = acted or [*odd_file_findings(wheels, recordings, noise), *size_findings(recordings, noise)]
  if not any(f.severity == "spoils" for f in acted):
    late = any(c.motion.acts and abs(c.lag.value) > LATE for c in compared)  # then it is no stretch that went wrong
    mixed = any(isinstance(f, TwoGroups) for f in acted)
    acted += command_findings(recordings, cuts=not late and not mixed, scale=wheels.scale)
    acted += direction_findings(wheels, recordings)
  acted += [*upside_down_findings(compared, any("pose_y" in r for r in recordings)), *mirrored_findings(recordings)]
  spoilt = {name for f in acted if f.severity == "spoils" for name in f.channels}  # first these, then what they take
  judged = [c for c in compared if not spoilt & {*c.motion.compared, *c.motion.reference}]
  tied = [c for c in judged if c.motion.kinematic and math.isfinite(c.lag.value)]
  timed = {name for c in tied for name in (*c.motion.compared, *c.motion.reference)}
  findings = [
    *acted,
    *(f for c in judged for f in disagreements(c, wheels, vehicle.wheelbase, recordings, noise, timed)),
    *scale_findings(judged, vehicle.wheelbase, {"cg_to_front", "cg_to_rear"} <= dataset.vehicle.keys()),
    *lag_findings(judged, vehicle.wheelbase),
  ]
  told = {name for f in findings if f.severity == "spoils" for name in f.channels}
  findings += [
    *(Finding("beware", _judged(warning), warning) for warning in dataset.notices),
    *_half_judged(recordings),
    *_short(recordings),
    *(pose_point_findings(recordings, vehicle) if not told & {"pose_x", "pose_y", "pose_yaw"} else []),
    *(grip_findings(compared, wheels, vehicle.wheelbase, recordings) if not told else []),
    *clock_findings(compared, wheels, vehicle.wheelbase, recordings),
    *lonely_findings(compared, recordings, told),
    *loose_findings(compared, recordings),
    *guessed_findings(compared, dataset.vehicle, dataset.vehicle_std),
    *(f for s in sampled for f in _held(s)),
    *(Finding("note", (), f"{s.physics}: not shown, no {s.takes}") for s in shown if s.verdict == "none"),
  ]
  if "drive" in dataset.vehicle and not any(f.severity == "spoils" for f in findings):
    findings += drive_findings(recordings, vehicle)
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


def _judged(warning: str) -> tuple[str, ...]:
  """The channel of a warning that every fit has to say again: one that stands for a sensor nobody had."""
  return ("speed",) if UNJUDGED in warning else ()


def _half_judged(recordings: Sequence[Recording]) -> list[Finding]:
  """A log in which nothing tells how the car turned, or nothing how it was steered or driven."""
  driven = any("speed_command" not in r.derived for r in recordings)
  if not driven and not any("steering_command" in r for r in recordings):
    said = (
      "neither a command of the drive nor of the steering is mapped, or both never change: what the car answered is"
    )
    cure = "map one in [channels]; a car that was pushed by hand shows nothing of its drive"
    return [Finding("spoils", ("steering_command",), f"{said} not known, and nothing can be fitted; {cure}")]
  if turns_unsteered(recordings):
    said = f"the car turned, and no steering_command is logged: turning, steering and tyres {UNJUDGED}; fits see the"
    cure = "map the steering in [channels], or log it; leave drives in tight turns out"
    return [Finding("beware", ("steering_command",), f"{said} speed and the acceleration along alone; {cure}")]
  if any({"yaw_rate", "pose_yaw", "pose_x", "accel_y"} & set(r.channels) for r in recordings):
    return []
  if not driven:
    said = "no command of the drive, and no gyro, no pose and no accelerometer across is mapped: neither the drive nor"
    return [Finding("spoils", ("steering_command",), f"{said} turning can be judged, and nothing fitted; map one")]
  said = "no gyro, no pose and no accelerometer across was logged: the drive can be judged; turning, steering and tyres"
  return [Finding("beware", ("steering_command",), f"{said} {UNJUDGED}, and keep the numbers they had")]


def _short(recordings: Sequence[Recording]) -> list[Finding]:
  """A log that is shorter than the stretches that a fit is cut in."""
  driven = sum(r.duration for r in recordings if r.role == "identify")
  if driven >= DEFAULT_CUT.length:
    return []
  said = f"{driven:.3g} s of driving are to be fitted, less than one stretch of {DEFAULT_CUT.length:g} s"
  return [Finding("beware", ("time",), f"{said}: hardly a number of the car shows in it; log a minute and more")]


def _held(s: Sampling) -> list[Finding]:
  if s.held < 1.5 or CHANNELS[s.channel].device in ("battery", "motor"):  # the drive's: nothing is fitted to them
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
