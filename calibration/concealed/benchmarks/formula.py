"""Formulas that are nobody's but the generator's, in cars whose true base is known, and what is found of them.

The base is recalibrated on the same car's session without an effect, so that what is left over is the effect and the
generator's own gaps: this measures finding a formula, not diagnosing. Effects are hidden in the independent cars alone.
"""

import dataclasses
import json
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from calibration.concealed.benchmarks.hidden_formulas import FORMULAS, SECOND, concealed
from calibration.diagnosis.candidates import candidate
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.formula.after import Shipped, formula_left
from calibration.diagnosis.formula.finding import Found
from calibration.diagnosis.formula.moments import by_pulse
from calibration.diagnosis.formula.report import said_by
from calibration.diagnosis.formula.words import alike_words, equation, sentence, variables
from calibration.diagnosis.pipeline import Prepared, prepare
from calibration.diagnosis.pool import Pool
from calibration.fitting.likelihood import Problem, weighting_from
from calibration.fitting.noise import noise_models
from calibration.fitting.noise_floor import sensor_floor
from calibration.fitting.observations import fitted_count, observe
from calibration.fitting.slopes import finite_differences
from calibration.fitting.windows import Cut
from calibration.log_check.ready import ready
from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.kinematics import rolling_radius
from qcar_twin.plant import Segments
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.variables import VARIABLES, spell

Array = NDArray[np.float64]
_ALONG = ("force_x", "motor_torque")
_POINTS = 300  # of a picture


def true_base(seed: int, car: str = "first") -> Prepared:
  """The base that a car's session without an effect gives."""
  return prepare(concealed(seed, "", car=car), threads=1)


@dataclasses.dataclass(frozen=True)
class Case:
  """One case, in values that a JSON file holds.

  Attributes:
    car, seed, name: the session; name is "" for the one without a formula.
    kind: "formula" or "table"; "" where nothing ships.
    said: what a report says of it.
    said_so: whether it says that something is there: what is shipped, or a dependence without a formula.
    formula: what is shipped; "" without.
    why: why nothing ships, in words; "" where something does.
    alike: what else it can't be told from, in words.
    change: held-out errors, after over before; 1 without any.
    seconds: that it took, of one core.
    error: root mean square difference to the true formula over what was driven, over that of the true one; None where
      nothing is shipped, or somewhere else.
    right_degree, right_variables: whether it acts where it should, on what it should; of what is shipped.
    finite: ten minutes of driving with the shipped twin end, and with finite signals; True where nothing is shipped.
    picture: force against variable, see `pictured`; empty where nothing was tried in the simulator.
  """

  car: str
  seed: int
  name: str
  kind: str
  said: str
  said_so: bool
  formula: str
  why: str
  alike: str
  change: float
  seconds: float
  error: float | None
  right_degree: bool
  right_variables: bool
  finite: bool
  picture: Mapping[str, Any] = dataclasses.field(default_factory=dict)

  @property
  def ships(self) -> bool:
    return bool(self.kind)

  @property
  def written(self) -> str:
    """The formula that is concealed."""
    return FORMULAS[self.name].written if self.name else "none"

  @property
  def close(self) -> bool:
    """Whether a formula is shipped that is off by less than a tenth."""
    return self.kind == "formula" and self.error is not None and self.error < 0.1

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
      wrong = [f"off by {100.0 * (self.error or 0.0):.0f} %"]
    return ", ".join(wrong)


def file_of(folder: Path, car: str, seed: int, name: str) -> Path:
  """Where a case is kept."""
  return folder / f"{car}_{seed}_{name or 'nothing'}.json"


def read_case(path: Path) -> Case:
  """A case from its file."""
  return Case(**json.loads(path.read_text(encoding="utf-8")))


def attempt(folder: Path, car: str, seed: int, names: Sequence[str]) -> str:
  """Look for the formulas of one car's sessions that are not in the folder yet; "", or a line that says what failed.

  An error's traceback stays in the folder until that is answered.
  """
  story = folder / f"{car}_{seed}.error.txt"
  todo = [name for name in names if not file_of(folder, car, seed, name).is_file()]
  try:
    base = true_base(seed, car) if todo else None
    for name in todo:
      assert base is not None
      write_json(file_of(folder, car, seed, name), dataclasses.asdict(case_of(base, car, seed, name)))
  except Exception as error:  # one car must not cost the others theirs
    write_text(story, traceback.format_exc())
    return f"{car} {seed} ({type(error).__name__}: {error})"
  story.unlink(missing_ok=True)
  return ""


def cases_of(
  seed: int, first: int, second: int, formulas: Sequence[str], each: int = 0
) -> list[tuple[str, int, list[str]]]:
  """Car, seed and formulas of every car; with `each` so many per car, in turn. Kinds of cars take turns.

  The session without a formula is each car's first.
  """
  kinds = {"first": range(seed, seed + first), "second": range(seed + first, seed + first + second)}
  out = []
  for car, seeds in kinds.items():
    there = [n for n in formulas if car == "first" or n in SECOND]
    for k, one in enumerate(seeds):
      turn = [there[(k * each + j) % len(there)] for j in range(each)] if each else there
      out.append((k / len(seeds), car, one, ["", *dict.fromkeys(turn)]))
  return [(car, one, names) for _, car, one, names in sorted(out)]


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
    ("of those that ship: held-out errors fall", shipping, lambda c: c.change < 1.0),
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
  seconds, rest = time.process_time() - began, shipped.rest
  right_degree, right_variables = _right(rest, name) if shipped.kept else (False, False)
  true = _true(rest, name)
  return Case(
    car, seed, name,
    kind=rest.kind if shipped.kept else "",
    said=sentence(rest, shipped.change),
    said_so=rest.sought is not None,
    formula=equation(rest) if shipped.kept else "",
    why="" if shipped.kept else rest.why or "held-out errors grow",
    alike=alike_words(rest),
    change=shipped.change,
    seconds=seconds,
    error=float(np.sqrt(np.mean((said_by(rest) * _lever(rest) - true) ** 2) / np.mean(true**2)))
    if shipped.kept and true is not None else None,
    right_degree=right_degree,
    right_variables=right_variables,
    finite=_finite(shipped),
    picture=pictured(rest, true),
  )  # fmt: skip


def _right(rest: Found, name: str) -> tuple[bool, bool]:
  """Whether it acts where it should, and on what it should."""
  truth = FORMULAS.get(name)
  if truth is None or rest.sought is None or rest.twin is None:
    return False, False
  law = frozenset(rest.twin.mechanism.law.variables) - ({"speed"} - truth.depends_on)
  return _true(rest, name) is not None, law == truth.depends_on


def _lever(rest: Found) -> float:
  """Of the degree of freedom as a force along the car, 1/m of a torque of the motor; 1 elsewhere."""
  assert rest.sought is not None
  driven, degree = rest.sought.driven, rest.sought.recovered.degree
  return 1.0 / rolling_radius(driven.car) if degree == "motor_torque" else 1.0


def _true(rest: Found, name: str) -> Array | None:
  """The true formula at every control period, a torque of the motor as a force along the car; None of another place."""
  truth = FORMULAS.get(name)
  if truth is None or rest.sought is None:
    return None
  degree, driven = rest.sought.recovered.degree, rest.sought.driven
  along = degree in _ALONG and truth.degree in _ALONG
  if not (along or degree == truth.degree):
    return None
  return truth.value_of(driven.values) / (rolling_radius(driven.car) if truth.degree == "motor_torque" else 1.0)


def pictured(rest: Found, true: Array | None) -> dict[str, Any]:
  """Force against the variable that it follows most, over pulses of 50 ms, some of them.

  Returns:
    x (of what, in words with its unit), y (likewise), at (values of x), recovered, told (by the formula or table that
    was tried) and true (None where the truth acts elsewhere); {} where nothing was tried.
  """
  names = variables(rest)
  if rest.sought is None or rest.twin is None or not names:
    return {}
  driven, force = rest.sought.driven, rest.sought.recovered
  degree, lever = DEGREES[force.degree], _lever(rest)
  seen = np.flatnonzero(force.std.reshape(-1) > 0.0)
  some = seen[:: max(1, len(seen) // _POINTS)]
  pulses = lambda values: by_pulse(values, driven.period).reshape(-1)[some].round(5).tolist()
  recovered = force.force.reshape(-1)[some] * rest.sought.responses.scale * lever
  acts = DEGREES["force_x"] if force.degree == "motor_torque" else degree
  return {
    "x": f"{VARIABLES[names[0]].words} [{spell(VARIABLES[names[0]].unit)}]",
    "y": f"{acts.symbol} [{acts.unit}]",
    "at": pulses(driven.values[names[0]]),
    "recovered": recovered.round(5).tolist(),
    "told": pulses(said_by(rest) * lever),
    "true": None if true is None else pulses(true),
  }


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
