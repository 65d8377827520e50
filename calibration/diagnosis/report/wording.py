"""Plain sentences about mechanisms and amounts, made from the declarations alone.

Nothing here knows a particular mechanism: its first docstring line says what happens, its parameters
say by how much.
"""

import math
import re
from collections.abc import Mapping, Sequence

from calibration.diagnosis.decision.claims import Claim
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.decision.departures import Departure
from calibration.diagnosis.decision.structure import PROPERTIES, Leftover
from calibration.diagnosis.region import Region
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages.numbers import spread
from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Mechanism, describe

_SMALLER = {"s": ("ms", 1e3, 0.5), "m": ("mm", 1e3, 0.5), "s/rad": ("ms/rad", 1e3, 0.5)}  # below this size, times that
_TOLD = 3  # figures that a verdict names, a choice: the page has all
_QUANTITIES = {"pose_yaw": "heading", "pose_x": "position x", "pose_y": "position y"}
_PRETTY = {"m/s^2": "m/s²", "kg m^2": "kg m²", "rad/s^2": "rad/s²"}


def amount(value: float, std: float | None, unit: str) -> str:
  """ "41.0 ± 2.1 ms", "1.50 ± 0.12° (0.0262 rad)", "0.052 ± 0.004": value and spread in a unit that reads well."""
  if unit == "rad":
    degrees = None if std is None else math.degrees(std)
    return f"{spread(math.degrees(value), degrees)}° ({value:.3g} rad)"
  if unit in _SMALLER and abs(value) < _SMALLER[unit][2]:
    name, factor, _ = _SMALLER[unit]
    return f"{spread(factor * value, None if std is None else factor * std)} {name}"
  return f"{spread(value, std)} {_PRETTY.get(unit, unit) if unit != '-' else ''}".rstrip()


def sizes(claim: Claim, mechanism: Mechanism) -> str:
  """The claimed amplitudes in words: "dead time 41.0 ± 2.1 ms"."""
  parts = []
  for parameter in mechanism.parameters:
    row = claim.parameters.get(parameter.name)
    if row is None or parameter.null is None:
      continue
    label = parameter.description or parameter.name.replace("_", " ")
    parts.append(f"{label} {amount(float(row['value']), float(row['std']), parameter.unit)}")
  return ", ".join(parts)


def happening(mechanism: Mechanism) -> str:
  """What a mechanism does, one sentence without its full stop: the first line of its docstring."""
  return str(describe(mechanism)["summary"]).rstrip(".")


def equation(mechanism: Mechanism) -> str:
  """The equation from the docstring, on one line; "" if it states none."""
  text = str(describe(mechanism)["text"])
  match = re.search(r"Equation:\s*(.*?)\n\s*(?:Units|Source|Confounded with|Signs?)\s*:", text + "\nUnits:", re.S)
  return re.sub(r"\s+", " ", match.group(1)).strip() if match else ""


def claim_sentence(claim: Claim, mechanism: Mechanism) -> str:
  """ "The steering executes what was commanded a while ago: dead time 41.0 ± 2.1 ms"."""
  size = sizes(claim, mechanism)
  return f"{happening(mechanism)}: {size}" if size else happening(mechanism)


def verdict_sentence(
  decision: Decision,
  mechanisms: Mapping[str, Mechanism],
  recovered: float | None = None,
  taken: Mapping[str, float] | None = None,
  short: str = "",
) -> str:
  """The verdict for a reader in a hurry: what was left out, how much, how sure; what is unexplained.

  Args:
    decision: names and verdict.
    mechanisms: claimed, by id.
    recovered: share of the squared error above sensor noise that the repair removes.
    taken: the same of each mechanism, by id.
    short: where the twin errs by more than its sensors, a clause; "" where it does not.
  """
  if decision.verdict == "no_mismatch":
    if not short:
      return "The recalibrated twin explains these recordings, and no missing physics shows in them."
    return f"In these recordings no missing physics shows. The twin itself falls short of them: {short}."
  if decision.verdict == "unexplained":
    about = f" The error behaves like {unknown_words(decision.unknown[0])}." if decision.unknown else ""
    if decision.leftovers:
      about = f" {structure_sentence(decision.leftovers[0])}"
    about = f" {decision.undecided}" if decision.undecided else about
    nearest = f" {decision.nearest}" if decision.nearest else ""
    return f"The twin is wrong in a way that none of the known mechanisms explains.{about}{nearest}"
  effects = " ".join(
    f"{claim_sentence(c, mechanisms[c.mechanism])}{doubts(c, (taken or {}).get(c.mechanism))}." for c in decision.claims
  )
  partly = " This explains only part of the mismatch." if decision.verdict == "partly_explained" else ""
  if partly and decision.leftovers:
    partly += f" {structure_sentence(decision.leftovers[0])}"
  unnamed = "The rest has no name, and no more structure than cars without a hidden effect show"
  rest = f" {unnamed}: {short}." if short and not partly else ""
  return f"{effects}{_gain(recovered)}{partly}{rest}"


def departures_sentence(departures: Sequence[Departure], claims: Sequence[Claim] = ()) -> str:
  """ " The driving contradicts what was measured of the car: mass 3.2 kg, measured 3.000 ± 0.010 kg.", and what is
  unusual of its sensors, which nobody measured and no claim has said."""
  told = {name for claim in claims for name in claim.parameters}
  said = lambda d: f"{d.name.replace('_', ' ')} {amount(d.value, None, d.unit)}"
  known = [f"{said(d)}, measured {amount(d.measured, d.std, d.unit)}" for d in departures if not d.usual]
  usual = [
    f"{said(d)}, usual {amount(d.measured, d.std, d.unit)}" for d in departures if d.usual and d.name not in told
  ]
  contradicted = f" The driving contradicts what was measured of the car: {'; '.join(known)}." if known else ""
  return contradicted + (f" Unusual of such sensors: {'; '.join(usual)}." if usual else "")


def unlike_sentence(figures: Sequence[tuple[Parameter, float]]) -> str:
  """ " Unlike other cars of the class: servo time constant 172 ms instead of 5 ms."; the three that are farthest."""
  said = [
    f"{p.name.replace('_', ' ')} {amount(value, None, p.unit)} instead of {amount(p.nominal, None, p.unit)}"
    for p, value in figures[:_TOLD]
  ]
  more = f"; and {len(figures) - _TOLD} more" if len(figures) > _TOLD else ""
  return f" Unlike other cars of the class: {'; '.join(said)}{more}." if said else ""


def _gain(recovered: float | None) -> str:
  if not recovered:
    return ""
  share = f"{100 * recovered:.0f} %"
  return f" The repaired twin's squared error above sensor noise is {share} smaller on held-out recordings."


def structure_sentence(item: Leftover) -> str:
  """ "Of the rest most structure is in longitudinal acceleration: turns with the heading (heading)."."""
  follows = listed([quantity(name) for name in item.depends_on])
  return f"Of the rest most structure is in {RESIDUALS[item.channel].words}: {PROPERTIES[item.family]} ({follows})."


def doubts(claim: Claim, taken: float | None = None) -> str:
  """ " (steering_delay, probability 0.97, takes off 93 %; indistinguishable from steering_lag)"."""
  share = "" if taken is None else f", takes off {100 * taken:.0f} %"
  if taken is not None and round(100 * taken) < 0:
    share = f", adds {-100 * taken:.0f} % to the error"
  equal = f"; indistinguishable from {listed(claim.indistinguishable_from)}" if claim.indistinguishable_from else ""
  doubted = "" if claim.certain else ", lowered by what has no name"
  return f" ({claim.mechanism}, probability {claim.probability:.2f}{doubted}{share}{equal})"


def quantity(name: str) -> str:
  """A channel or a circumstance in words: "accel_x" -> "longitudinal acceleration", "abs(yaw_rate)" -> "size of …"."""
  bare = name.removeprefix("abs(").removesuffix(")") if name.startswith("abs(") else name
  words = RESIDUALS[bare].words if bare in RESIDUALS else _QUANTITIES.get(bare, bare.replace("_", " "))
  return words if bare == name else f"size of the {words}"


def rule(region: Region) -> str:
  """An operating region in words: "longitudinal acceleration at most −0.71 m/s²"."""
  parts = []
  for condition in region.conditions:
    unit = region.units.get(condition.feature, "")
    bound = "above" if condition.above else "at most"
    size = f"{condition.value:g}".replace("-", "−")
    parts.append(f"{quantity(condition.feature)} {bound} {size} {_PRETTY.get(unit, unit)}".rstrip())
  return " and ".join(parts) or "all driving"


def unknown_words(name: str) -> str:
  """An unnamed error in words: "unknown_force_x" -> "an unknown force along the car"."""
  known = {
    "force_x": "an unknown force along the car",
    "force_y": "an unknown force across the car",
    "moment_z": "an unknown yaw moment",
    "voltage": "an unknown change of the motor's voltage",
    "steering": "an unknown change of the steering angle",
  }
  bare = name.removeprefix("unknown_")
  if bare.startswith("sensor_"):
    return f"an unknown error of the {quantity(bare.removeprefix('sensor_'))} sensor"
  return known.get(bare, f"an unknown {bare.replace('_', ' ')}")


def listed(names: Sequence[str]) -> str:
  """ "a", "a and b", "a, b and c"."""
  return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else ""
