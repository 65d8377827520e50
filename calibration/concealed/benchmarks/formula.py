"""Formulas that are nobody's but the generator's, in cars whose true base is known, and what is found of them.

The base is recalibrated on the same car's session without an effect, so that what is left over is the effect and the
generator's own gaps: this measures finding a formula, not diagnosing. Effects are hidden in the independent cars alone.
"""

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from calibration.concealed.benchmarks.hidden_formulas import FORMULAS, SECOND, concealed
from calibration.diagnosis.candidates import candidate
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.formula.after import Shipped, formula_left
from calibration.diagnosis.formula.report import said_by
from calibration.diagnosis.formula.words import sentence
from calibration.diagnosis.pipeline import Prepared, prepare
from calibration.diagnosis.pool import Pool
from calibration.fitting.likelihood import Problem, weighting_from
from calibration.fitting.noise import noise_models
from calibration.fitting.noise_floor import sensor_floor
from calibration.fitting.observations import observe
from calibration.fitting.optimiser import finite_differences
from calibration.fitting.recalibration import fitted_count
from calibration.fitting.windows import Cut
from calibration.log_check.ready import ready
from qcar_twin.kinematics import rolling_radius
from qcar_twin.plant import Segments
from qcar_twin.recordings.dataset import DataSet

Array = NDArray[np.float64]
_ALONG = ("force_x", "motor_torque")


def true_base(seed: int, car: str = "first") -> Prepared:
  """The base that a car's session without an effect gives."""
  return prepare(concealed(seed, "", car=car), threads=1)


@dataclasses.dataclass(frozen=True)
class Case:
  """One case.

  Attributes:
    car, seed, name: the session; name is "" for the one without a formula.
    shipped: what was found.
    seconds: that it took, of one core.
    error: root mean square difference to the true formula over what was driven, over that of the true one; NaN where
      nothing is shipped, or somewhere else.
    right_degree, right_variables: whether it acts where it should, on what it should; of what is shipped.
    finite: ten minutes of driving with the shipped twin end, and with finite signals; True where nothing is shipped.
  """

  car: str
  seed: int
  name: str
  shipped: Shipped
  seconds: float
  error: float
  right_degree: bool
  right_variables: bool
  finite: bool

  @property
  def ships(self) -> bool:
    return self.shipped.kept

  @property
  def said_so(self) -> bool:
    """Whether it says that something is there: what is shipped, or a dependence without a formula."""
    return self.shipped.rest.sought is not None

  @property
  def said(self) -> str:
    """What a report says of it."""
    return sentence(self.shipped.rest, self.shipped.change)

  @property
  def written(self) -> str:
    """The formula that is concealed."""
    return FORMULAS[self.name].written if self.name else "none"

  @property
  def close(self) -> bool:
    """Whether a formula is shipped that is off by less than a tenth."""
    return self.ships and self.shipped.rest.kind == "formula" and self.error < 0.1

  @property
  def falls_short(self) -> str:
    """What is wrong with it, in words; "" where nothing is."""
    if not self.name:
      return "something ships where nothing is concealed" if self.ships else ""
    if not self.ships:
      return "nothing ships"
    wrong = [w for w, right in (("the wrong place", self.right_degree), ("the wrong variables", self.right_variables),
                                ("ten minutes of driving do not stay finite", self.finite)) if not right]  # fmt: skip
    if not wrong and not self.close:
      wrong = [f"off by {100.0 * self.error:.0f} %"]
    return ", ".join(wrong)


def cases_of(
  seed: int, first: int, second: int, formulas: Sequence[str], each: int = 0
) -> Iterator[tuple[str, int, list[str]]]:
  """Car, seed and formulas of every car; with `each` so many per car, in turn."""
  begun = 0
  for car, seeds in (("first", range(seed, seed + first)), ("second", range(seed + first, seed + first + second))):
    there = [n for n in formulas if car == "first" or n in SECOND]
    for one in seeds:
      turn = [there[(begun + k) % len(there)] for k in range(each)] if each else there
      begun += each
      yield car, one, list(dict.fromkeys(turn))


def rates(cases: Sequence[Case]) -> list[tuple[str, str, str]]:
  """What was counted, how often, and its exact 95 % interval."""
  nulls, hidden = ([c for c in cases if bool(c.name) == one] for one in (False, True))
  shipping = [c for c in hidden if c.ships]
  rows: list[tuple[str, list[Case], Callable[[Case], bool]]] = [
    ("nothing concealed: something ships", nulls, lambda c: c.ships),
    ("a formula concealed: said that something is there", hidden, lambda c: c.said_so),
    ("a formula concealed: something ships", hidden, lambda c: c.ships),
    ("a formula concealed: the right place", hidden, lambda c: c.right_degree),
    ("a formula concealed: the right variables", hidden, lambda c: c.right_degree and c.right_variables),
    ("a formula concealed: a formula within 10 % over the driving", hidden, lambda c: c.close),
    ("of those that ship: held-out errors fall", shipping, lambda c: c.shipped.change < 1.0),
    ("of all that ship: ten minutes of driving stay finite", [c for c in cases if c.ships], lambda c: c.finite),
  ]
  out = []
  for said, among, what in rows:
    count = sum(map(what, among))
    low, high = binomtest(count, len(among)).proportion_ci(0.95, "exact") if among else (0.0, 1.0)
    out.append((said, f"{count} of {len(among)}", f"{100.0 * low:.0f} to {100.0 * high:.0f} %"))
  return out


def case_of(base: Prepared, car: str, seed: int, name: str) -> Case:
  """Look for the formula of one session at the car's true base."""
  pool, holdout = _at_base(base, ready(concealed(seed, name, car=car))[0])
  began = time.process_time()
  shipped = formula_left(pool, Decision("unexplained", (), (), (), None, ()), holdout, Cut())
  assert shipped is not None
  return _judged(Case(car, seed, name, shipped, time.process_time() - began, np.nan, False, False, _finite(shipped)))


def _judged(case: Case) -> Case:
  rest, truth = case.shipped.rest, FORMULAS.get(case.name)
  if truth is None or not (case.ships and rest.sought and rest.twin and rest.sought.forms):
    return case
  degree, error = rest.sought.recovered.degree, np.nan
  along = degree in _ALONG and truth.degree in _ALONG
  if along or degree == truth.degree:
    driven = rest.sought.driven
    radius = rolling_radius(driven.car)
    lever = {"force_x": 1.0, "motor_torque": 1.0 / radius} if along else {}
    true = truth.value_of(driven.values) * lever.get(truth.degree, 1.0)
    off = said_by(rest) * lever.get(degree, 1.0) - true
    error = float(np.sqrt(np.mean(off**2) / np.mean(true**2)))
  law = frozenset(rest.twin.mechanism.law.variables) - ({"speed"} - truth.depends_on)
  right = {"right_degree": along or degree == truth.degree, "right_variables": law == truth.depends_on}
  return dataclasses.replace(case, error=error, **right)


def _finite(shipped: Shipped, seconds: float = 600.0) -> bool:
  """Whether a shipped twin drives ten minutes of swinging commands with finite signals."""
  if not shipped.kept or shipped.rest.twin is None:
    return True
  twin, theta = shipped.rest.twin.problem.exact.twin, shipped.rest.twin.theta
  wave = np.sin(0.7 * np.arange(int(100 * seconds)) / 100.0)
  commands = np.column_stack([1.5 + wave, 0.3 * wave])[None]
  segments = Segments(commands, np.zeros((1, 7)), np.array([len(wave)]), 0.01, ("long",), np.zeros(1))
  return bool(np.isfinite(twin.rollout(theta[None], segments).signals).all())


def _at_base(base: Prepared, dataset: DataSet) -> tuple[Pool, list]:
  """A pool whose only model is a base, and the held-out recordings."""
  theta, priors = base.recalibrated.theta, base.recalibrated.fit.parameters
  recordings = sorted((r for r in dataset.recordings if r.role != "holdout"), key=lambda r: r.role == "validate")
  twin, floor = base.recalibrated.problem.at(theta).twin, sensor_floor(noise_models(recordings))
  observations = observe(recordings, twin.vehicle, Cut())
  flat = weighting_from(observations, observations.measured, {})
  problem = Problem(twin, observations, flat, fitted_count(observations, recordings), priors.names)
  problem = problem.reweighted(weighting_from(observations, problem.raw(theta[None])[0], floor))
  model = candidate(problem, (), None, priors)
  model.theta, model.values = theta.copy(), base.recalibrated.fit.theta.copy()
  everything = lambda v: problem.residual(problem.embed(priors.names, v, theta))
  model.residual = everything(model.values[None])[0]
  model.jacobian = finite_differences(everything, model.free, model.values, model.residual)
  return Pool(problem, priors, {frozenset(): model}, {}, floor), list(dataset.role("holdout"))
