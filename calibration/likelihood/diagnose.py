"""A diagnosis by likelihood from end to end: a data set in, claims with sizes, what is left, errors in free runs."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.considered import considered
from calibration.diagnosis.holdout_errors import ChannelFit, compare_twins
from calibration.fitting.dataset_recalibration import LONGEST
from calibration.fitting.noise import noise_passport
from calibration.fitting.noise_floor import sensor_floor
from calibration.fitting.windows import Cut
from calibration.likelihood.body_force import BodyForce
from calibration.likelihood.hypotheses import Option, options
from calibration.likelihood.levels import Levels, levels
from calibration.likelihood.noise import FITTED, first_noise
from calibration.likelihood.priors import base_priors
from calibration.likelihood.readings import read
from calibration.likelihood.refit import Minimum
from calibration.likelihood.remains import Remains, remains
from calibration.likelihood.search import Found, Setting, search
from calibration.likelihood.second_stage import calibrated, calibrated_with
from calibration.log_check.ready import ready
from calibration.progress import Progress, silent
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]

_SHIPPED = 2  # simulation steps per control period of the twin that is shipped, as of every calibration


@dataclasses.dataclass(frozen=True)
class Finding:
  """What a diagnosis by likelihood found.

  Attributes:
    dataset: its name.  found: minima and names.  last: the minimum with the claims.
    claims: names that are also material in free runs, with probabilities.
    remains: what the smoothed forces still depend on.
    twin: in MuJoCo; before, after: its parameters without the claims, and those that are shipped, (P,): with the
      claims, unless these make free runs worse.
    validate, holdout: free-run errors per channel.  seconds: wall time.  notes: on the data set.
  """

  dataset: str
  found: Found
  last: Minimum
  claims: tuple[tuple[Option, float], ...]
  remains: Remains
  twin: Twin
  before: Array
  after: Array
  validate: Mapping[str, ChannelFit]
  holdout: Mapping[str, ChannelFit]
  seconds: float
  notes: tuple[str, ...]

  @property
  def verdict(self) -> str:
    """One of the four that every diagnosis ends in."""
    if self.claims:
      return "partly_explained" if self.remains.significant else "explained"
    return "unexplained" if self.remains.significant or self.found.names else "no_mismatch"


def diagnose_by_likelihood(
  dataset: DataSet, mechanisms: Sequence[str] | None = None, substeps: int = 5, threads: int = 0,
  limits: Levels | None = None, progress: Progress = silent,
) -> Finding:  # fmt: skip
  """Find out what physics a data set shows that the twin lacks, by likelihood.

  Args:
    dataset: recordings with roles; "identify" is fitted, "validate" judges, "holdout" is opened at the end.
    mechanisms: ids to consider; the whole catalogue by default.
    substeps: simulation steps per control period.  threads: of the simulation, 0 for all cores.
    limits: the numbers that decide; those of levels.toml by default.

  Raises:
    ValueError: the reduced car lacks something that this car has, or no recording is long enough.
  """
  since, limits = time.perf_counter(), limits or levels()
  dataset, notes = ready(dataset)
  vehicle = Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std)
  known, fitted = considered(mechanisms, None, vehicle.drive), list(dataset.role("identify"))
  twin = Twin(vehicle, [*known, BodyForce()], substeps=substeps, threads=threads, engine="reduced")
  base = base_priors(fitted, twin)
  readings = read(fitted, vehicle, Cut(most=LONGEST))
  nominal = twin.parameters.vector({p.name: p.nominal for p in base})
  setting = Setting(twin, readings, base, tuple(options(known, base, readings)), nominal)
  found = search(setting, first_noise(fitted, readings), limits, progress)
  progress("free runs")
  exact = Twin(vehicle, known, substeps=_SHIPPED, threads=threads)
  floor = sensor_floor(noise_passport(fitted))
  judge = lambda role, one, other: compare_twins(exact, one, other, dataset.role(role), floor, Cut(most=LONGEST))[0]
  progress("calibration in free runs")
  before = calibrated(exact, dataset)
  names, tried = claimed(
    found,
    before,
    lambda names: calibrated_with(exact, dataset, names, found.minimum(names)),
    lambda one, other: material(judge("validate", one, other), limits),
  )
  last = found.minimum(names)
  claims = tuple((o, probability(found, last, o)) for o in names)
  after = tried if harmless(judge("validate", before, tried), limits) else before
  validate, holdout = (judge(role, before, after) for role in ("validate", "holdout"))
  rest = remains(found.settled(names), limits)
  seconds, said = time.perf_counter() - since, dataset.notices + notes
  return Finding(dataset.name, found, last, claims, rest, exact, before, after, validate, holdout, seconds, said)


def claimed(
  found: Found, before: Array, fit: Callable[[Sequence[Option]], Array], is_material: Callable[[Array, Array], bool]
) -> tuple[tuple[Option, ...], Array]:
  """The names that are material, each beside those claimed before it in the order in which they were found.

  Args:
    before: calibration without a name, (P,).  fit: one with names.
    is_material: whether a calibration is so much better than another.

  Returns:
    the names, and the calibration with them. What was only refitted together with a name that is not material is not
    claimed.
  """
  kept: tuple[Option, ...] = ()
  theta = before
  for option in found.names:
    if found.has((*kept, option)):
      tried = fit((*kept, option))
      if is_material(theta, tried):
        kept, theta = (*kept, option), tried
  return kept, theta


def material(fits: Mapping[str, ChannelFit], limits: Levels) -> bool:
  """Whether some channel's squared free-run error loses a stated share.

  Without recordings that judge, evidence alone decides.
  """
  return not fits or max(1.0 - (f.after / f.before) ** 2 for f in fits.values() if f.before > 0.0) >= limits.material


def harmless(fits: Mapping[str, ChannelFit], limits: Levels) -> bool:
  """Whether no channel's free-run error grows by more than a stated share and beyond chance."""
  return not any(f.after > (1.0 + limits.harmless) * f.before and f.ci95[0] > 0.0 for f in fits.values())


def probability(found: Found, last: Minimum, option: Option) -> float:
  """Of a name among the refitted rivals of its kind: exp(-cost) over their sum, with the base among them."""
  own = last.cost
  rivals = [cost for key, cost in found.models.items() if not any(k.split(" ")[0] == option.name for k in key)]
  return float(1.0 / (1.0 + sum(np.exp(min(own - cost, 50.0)) for cost in rivals)))


def document(finding: Finding) -> dict:
  """The finding as plain types, with the keys of a diagnosis that a campaign scores."""
  found, best = finding.found, finding.last
  fits = lambda table: {name: dataclasses.asdict(f) | {"ci95": list(f.ci95)} for name, f in table.items()}
  first = finding.claims[0][0].name if finding.claims else ""
  gains: dict[str, float] = {}
  for key, cost in found.models.items():
    if len(key) == 1:
      gains[key[0].split(" ")[0]] = max(found.base.cost - cost, gains.get(key[0].split(" ")[0], -np.inf))
  named = {o.name for o, _ in finding.claims}
  order = [o.name for o, _ in finding.claims] + [n for n in sorted(gains, key=lambda n: -gains[n]) if n not in named]
  scanned = {key.split(" ")[0]: nats for key, nats in found.scan}
  order += [n for n in scanned if n not in order]
  return {
    "verdict": finding.verdict,
    "claims": [_claim(finding, o, p) for o, p in finding.claims],
    "ranking": [{"mechanism": n, "evidence_nats": gains.get(n, scanned.get(n, 0.0))} for n in order[:12]],
    "where": {
      "subsystem": catalogue()[first].subsystem if first else "",
      "depends_on": list(finding.remains.depends_on),
    },
    "unknown": {"depends_on": list(finding.remains.depends_on), "gains": dict(finding.remains.gains)},
    "fit": {"validate": fits(finding.validate), "holdout": fits(finding.holdout)},
    "noise": {name: best.noise.value(name) for name in FITTED},
    "shifts": {
      p.name: float((v - p.nominal) / s) for p, v, s in zip(best.free, best.values, best.free.std, strict=True)
    },
    "level": found.level,
    "nats": found.base.cost - best.cost,
    "models": [
      {"set": list(k), "nats": found.base.cost - c} for k, c in sorted(found.models.items(), key=lambda m: m[1])
    ],
    "forces": dict(finding.remains.forces),
    "simulations": found.simulations,
    "seconds": finding.seconds,
    "statistics": {},
  }


def _claim(finding: Finding, option: Option, share: float) -> dict:
  best = finding.last
  std = dict(zip(best.free.names, best.std, strict=True))
  values = dict(zip(best.free.names, best.values, strict=True))
  names = [p for p in (*option.amplitudes, *option.shapes)]
  return {
    "mechanism": option.name,
    "probability": share,
    "evidence_nats": finding.found.base.cost - best.cost,
    "parameters": {p.name: {"value": float(values[p.name]), "std": float(std[p.name]), "unit": p.unit} for p in names},
    "rivals": [],
    "equivalent_to": [],
  }
