"""Two data sets of one car, or of two: which of its numbers moved.

Both are characterised on their own, with the knots of their curves at the same commands and speeds, so that every
number of the one has its counterpart. A number moved where the two differ by more than chance over all of them would.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.stats import norm

from calibration.diagnosis.curves.flexible import Characterised, characterise, reaches
from calibration.diagnosis.curves.naming.forms import LEVEL
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.log_check.ready import ready
from calibration.progress import Progress, silent
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.vehicle.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class Moved:
  """One number in two data sets.

  Attributes:
    name: of the parameter; unit: its unit.
    first, second: estimate and deviation in each; what nobody measured has a wide prior in both, and what stopped at a
      bound has the bound.
    chance: how often two fits of one car differ as much, two-sided.
    there: rarer than LEVEL over all numbers that are compared (Bonferroni).
  """

  name: str
  unit: str
  first: tuple[float, float]
  second: tuple[float, float]
  chance: float
  there: bool


def compare_cars(
  first: DataSet, second: DataSet, most: float = LONGEST, threads: int = 0, progress: Progress = silent
) -> tuple[Moved, ...]:
  """Every number that both data sets know, the surest difference first.

  Args:
    first, second: data sets with roles; the hold-outs are not looked at.
    most: s of driving that each is fitted to.
    threads: of the simulation, 0 for all cores.
    progress: reports the stage.

  Raises:
    ValueError: the two cars are not of one layout and drive, or share no parameter that both recordings show.
  """
  checked = [ready(d)[0] for d in (first, second)]
  vehicles = [Vehicle.from_dataset(d.vehicle, d.vehicle_std) for d in checked]
  kinds = [(v.layout, v.drive) for v in vehicles]
  if kinds[0] != kinds[1]:
    raise ValueError(
      f"data set {first.name} has layout and drive {kinds[0]}, {second.name} {kinds[1]}: their numbers have no "
      "counterparts; compare cars whose [vehicle] tables agree in `layout` and `drive`"
    )
  shared = _shared_reaches([reaches([r for r in d.recordings if r.role != "holdout"], v)
                            for d, v in zip(checked, vehicles, strict=True)])  # fmt: skip
  found = []
  for dataset in checked:
    progress(f"curves of {dataset.name}")
    found.append(characterise(dataset, most=most, threads=threads, reach=shared))
  return compared(*found)


def compared(first: Characterised, second: Characterised) -> tuple[Moved, ...]:
  """The numbers of two characterised twins that both have free."""
  return differing(estimates(first), estimates(second), units(first))


def differing(
  one: dict[str, tuple[float, float]], other: dict[str, tuple[float, float]], unit: dict[str, str]
) -> tuple[Moved, ...]:
  """The same of estimates and deviations by name; `unit`: of each name."""
  both = [name for name in one if name in other]
  if not both:
    raise ValueError("the two data sets show no parameter in common")
  made = []
  for name in both:
    (value, std), (value_too, std_too) = one[name], other[name]
    chance = float(2.0 * norm.sf(abs(value - value_too) / np.hypot(std, std_too)))
    made.append(Moved(name, unit[name], one[name], other[name], chance, chance * len(both) < LEVEL))
  return tuple(sorted(made, key=lambda m: m.chance))


def sentences(moved: Sequence[Moved], first: str, second: str) -> list[str]:
  """What the terminal says: what moved, a line each, or that nothing did."""
  told = lambda estimate: f"{estimate[0]:.4g} ± {estimate[1]:.1g}"
  said = [f"{m.name}: {told(m.first)} in {first}, {told(m.second)} {m.unit} in {second}" for m in moved if m.there]
  if not said:
    return [f"nothing moved between {first} and {second} beyond chance, of {len(moved)} numbers"]
  return [f"{len(said)} of {len(moved)} numbers moved:", *said]


def _shared_reaches(both: Sequence[dict[str, float]]) -> dict[str, float]:
  """Where both were driven: beyond the lesser of the two one of them says nothing."""
  return {name: min(reach[name] for reach in both) for name in both[0]}


def estimates(found: Characterised) -> dict[str, tuple[float, float]]:
  """Estimate and deviation by parameter; sessions' own shifts left out.

  What stopped at a bound is there, too, with the deviation that it would have without: its estimate would then lie
  farther out, so that it differs from a number within the bounds by no less than is told.
  """
  fit, names = found.fitted.fit, found.fitted.fit.parameters.names
  fixed = {p.name for m in found.twin.mechanisms if m.name in found.curves for p in m.parameters if p.null is None}
  return {
    name: (value, spread)
    for name, value, spread in zip(names, fit.theta.tolist(), found.deviations.tolist(), strict=True)
    if spread > 0.0 and "@" not in name and name not in fixed
  }


def units(found: Characterised) -> dict[str, str]:
  """Unit of every fitted parameter."""
  return {p.name: p.unit for p in found.fitted.fit.parameters}
