"""What was lost in translation: the hold-out driven with the written file, beside the twin.

The twin's effects on sensors act on both, since an export is a car and no sensor. What an effect costs by itself is
told by taking it out of the twin. What it costs beside everything else that is lost is less, since losses hide each
other: it is measured by putting it back around the export, where an effect of commands can be, and predicted by putting
it back into the twin that lacks what the export lacks.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.exports.cars import ModelCars
from calibration.exports.numbers import without
from calibration.exports.target import Job, Target
from calibration.fitting.observations import UNITS, observe
from calibration.fitting.windows import Cut
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]
WINDOW = 2.0  # s, restarts from what was measured, as in cross-validation
# s, unjudged: windows begin as the twin's tyres slip; relaxation of 0.05 m is over then, at 0.5 m/s
_WARM_UP = 0.1
EXPRESSIBLE = 1.15  # of the twin's error: an export that holds every name should stay below
PREDICTED = 0.2  # within which a loss should be predicted


@dataclasses.dataclass(frozen=True)
class EffectLoss:
  """One effect that a target cannot express: error without it over error with it, by channel.

  Attributes:
    alone: of the twin that has everything else.
    predictions, measurements: of the twin that lacks everything that the target lacks, and of the export, with the
      effect put back around it; None where it cannot be.
  """

  name: str
  alone: Mapping[str, float]
  predictions: Mapping[str, float] | None = None
  measurements: Mapping[str, float] | None = None

  @property
  def predicted(self) -> float | None:
    """Geometric mean over channels; None where nothing measures it."""
    return None if self.predictions is None else _mean(self.predictions)

  @property
  def measured(self) -> float | None:
    """The same of the export."""
    return None if self.measurements is None else _mean(self.measurements)

  def document(self) -> dict[str, Any]:
    """For JSON."""
    means = {"costs": _mean(self.alone), "predicted": self.predicted, "measured": self.measured}
    return {**dataclasses.asdict(self), **means}

  def line(self) -> str:
    """For people, with the channel that loses most."""
    said = f"without {self.name}: the twin {_said(self.alone)}"
    if self.predictions is None or self.measurements is None:
      return said
    return f"{said}; all else lost, predicted {_said(self.predictions)}, measured {_said(self.measurements)}"


@dataclasses.dataclass(frozen=True)
class Loss:
  """Root mean square errors by channel, in its unit.

  Attributes:
    roles: of the recordings that were driven.
    twin, export: errors.  without: of the twin without every effect that the target lacks.
    effects: one by one.
  """

  roles: tuple[str, ...]
  twin: Mapping[str, float]
  export: Mapping[str, float]
  without: Mapping[str, float]
  effects: tuple[EffectLoss, ...]

  @property
  def ratio(self) -> float:
    """Export over twin, a geometric mean over channels."""
    return mean_ratio(self.export, self.twin)

  @property
  def predicted(self) -> float:
    """The same of the twin without what the target lacks."""
    return mean_ratio(self.without, self.twin)

  def document(self) -> dict[str, Any]:
    """For JSON."""
    effects = [effect.document() for effect in self.effects]
    means = {"ratio": self.ratio, "predicted": self.predicted, "window": WINDOW}
    return {**dataclasses.asdict(self), "effects": effects, **means}

  def lines(self) -> list[str]:
    """For people."""
    said = [f"lost in translation, windows of {WINDOW:g} s of role {', '.join(self.roles)}:"]
    said.append(f"  {'channel':<22}{'twin':>10}{'export':>10}{'ratio':>8}{'predicted':>11}")
    for name, error in self.twin.items():
      unit = f"{name} [{UNITS[name]}]"
      ratios = self.export[name] / error, self.without[name] / error
      said.append(f"  {unit:<22}{error:>10.3g}{self.export[name]:>10.3g}{ratios[0]:>8.2f}{ratios[1]:>11.2f}")
    said.append(f"  {'all (geometric mean)':<42}{self.ratio:>8.2f}{self.predicted:>11.2f}")
    said += [f"  {effect.line()}" for effect in self.effects]
    return [*said, *(f"  {sentence}" for sentence in self.sentences())]

  def sentences(self) -> list[str]:
    """What to beware of: the channel that loses most, and those of which the prediction is off."""
    made, measured, predicted = [], ratios(self.export, self.twin), ratios(self.without, self.twin)
    worst = max(measured, key=lambda name: measured[name])
    if measured[worst] > EXPRESSIBLE:
      made.append(f"{worst} loses most: {measured[worst]:.1f} times the twin's error")
    off = [name for name in measured if abs(np.log(predicted[name] / measured[name])) > np.log1p(PREDICTED)]
    if off:
      those = "; ".join(f"{name} {predicted[name]:.2f}, measured {measured[name]:.2f}" for name in off)
      made.append(f"prediction off by more than {100.0 * PREDICTED:.0f} %: {those}")
    return made


def _said(ratio: Mapping[str, float]) -> str:
  worst = max(ratio, key=lambda name: ratio[name])
  return f"{_mean(ratio):.2f}" + (f" ({worst} {ratio[worst]:.2f})" if ratio[worst] > EXPRESSIBLE else "")


def _mean(ratio: Mapping[str, float]) -> float:
  return float(np.exp(np.mean(np.log(list(ratio.values())))))


def ratios(errors: Mapping[str, float], others: Mapping[str, float]) -> dict[str, float]:
  """One error over the other by channel."""
  return {name: errors[name] / others[name] for name in others}


def mean_ratio(errors: Mapping[str, float], others: Mapping[str, float]) -> float:
  """Geometric mean over channels of one error over the other."""
  return _mean(ratios(errors, others))


def measure_loss(job: Job, target: Target, path: Path) -> Loss | None:
  """Drive the hold-out (else the validation recordings) with the file; None without a data set or for no car."""
  if target.drives is None or job.dataset is None:
    return None
  roles = ("holdout",) if any(r.role == "holdout" for r in job.dataset.recordings) else ("validate",)
  recordings = [r for r in job.dataset.recordings if r.role in roles]
  if not recordings:
    return None
  cut = Cut(length=WINDOW, warm_up=_WARM_UP, command_shift=job.command_shift)
  observations = observe(recordings, job.twin.vehicle, cut, horizon=1.0)
  segments = observations.stretches.segments
  model, car = target.drives(path, job)

  def errors(twin: Twin, theta: Array) -> dict[str, float]:
    wrong = observations.predict(twin.rollout(theta, segments))[0] - observations.measured
    return {c: float(np.sqrt(np.mean(wrong[observations.select(c)] ** 2))) for c in observations.present}

  sensors = [m for m in job.present if m.stage == "sensor"]
  lost = job.lost(target)

  def exported(around: Sequence[Mechanism]) -> dict[str, float]:
    part, theta = without(job.twin, job.theta, [m for m in job.twin.mechanisms if m in (*sensors, *around)])
    return errors(part.with_engine(lambda size: ModelCars(model, car, size)), theta)

  def reduced(
    gone: Sequence[Mechanism], theta: Array = job.theta, instead: Sequence[Mechanism] = ()
  ) -> dict[str, float]:
    return errors(*without(job.twin, theta, [*(m for m in job.present if m not in gone), *instead]))

  twin, export = reduced(()), exported(())
  theirs = {name: made(path) for name, made in target.instead.items()}
  plain, instead = job.plain(target), tuple(theirs.values())
  bare = reduced(lost, plain, instead)
  effects = []
  for mechanism in lost:
    alone = ratios(reduced((mechanism,)), twin)
    beside = measured = None
    if mechanism.stage in ("command", "actuator"):
      beside = ratios(bare, reduced([m for m in lost if m is not mechanism], plain, instead))
      measured = ratios(export, exported((mechanism,)))
    effects.append(EffectLoss(mechanism.name, alone, beside, measured))
  for name in target.structure:
    effects.append(EffectLoss(name, ratios(reduced((), job.plain(target, name)), twin)))
  for name, mechanism in theirs.items():
    effects.append(EffectLoss(name, ratios(reduced((), instead=(mechanism,)), twin)))
  return Loss(roles, twin, export, bare, tuple(effects))
