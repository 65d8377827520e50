"""Formulas that are nobody's but the generator's, in cars whose true base is known, and what is found of them.

The base is recalibrated on the same car's session without an effect, so that what is left over is the effect and the
generator's own gaps: this measures finding a formula, not diagnosing. An effect is hidden in the independent car alone.
"""

import contextlib
import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from calibration.concealed.proving_ground import EFFECTS, make_session
from calibration.concealed.proving_ground.effects.outside import Outside
from calibration.diagnosis.candidates import candidate
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.formula.after import Shipped, formula_left
from calibration.diagnosis.formula.report import said_by
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
from qcar_twin.recordings.dataset import DataSet

Array = NDArray[np.float64]
FORMULAS: dict[str, type["Hidden"]] = {}
_ALONG = ("force_x", "motor_torque")


class Hidden(Outside):
  """Base: an effect of this file, which no campaign draws.

  Class attributes: `degree` (where it acts), `depends_on` (variables), `written` (its formula), `value_of` (its value
  in the degree's unit from the twin's variables, for size 1).
  """

  degree: ClassVar[str]
  depends_on: ClassVar[frozenset[str]]
  written: ClassVar[str]
  value_of: ClassVar[Callable[[Mapping[str, Array]], Array]]

  def __init_subclass__(cls) -> None:
    FORMULAS[cls.id] = cls


class TurningDrag(Hidden):
  """Turning the car drags on it."""

  id, subsystem, parameter, typical, unit = "turning_drag", "body", "drag_per_yaw_rate", 1.2, "N s/rad"
  carried_by, degree, depends_on = ("motion",), "force_x", frozenset(("yaw_rate",))
  written = "F_x = -1.2 |r| sgn(v)"
  value_of = staticmethod(lambda x: -1.2 * np.abs(x["yaw_rate"]) * np.tanh(x["speed"] / 0.05))

  def load(self, sim) -> None:  # noqa: ANN001
    s, c = sim.dynamics.stage, self.columns
    sim.dynamics.wrench[0, c] -= self.value * np.abs(s.yaw_rate[c]) * np.tanh(s.vx[c] / 0.05)


class CornerDrag(Hidden):
  """Cornering at speed drags on it."""

  id, subsystem, parameter, typical, unit = "corner_drag", "body", "drag", 0.25, "N s^3/m^2"
  carried_by, degree, depends_on = ("motion",), "force_x", frozenset(("speed", "accel_y"))
  written = "F_x = -0.25 v |a_y|"
  value_of = staticmethod(lambda x: -0.25 * x["speed"] * np.abs(x["speed"] * x["yaw_rate"]))

  def load(self, sim) -> None:  # noqa: ANN001
    s, c = sim.dynamics.stage, self.columns
    sim.dynamics.wrench[0, c] -= self.value * s.vx[c] * np.abs(s.yaw_rate[c] * s.vx[c])


class Rug(Hidden):
  """A rug in the room."""

  id, subsystem, parameter, typical, unit = "rug", "ground", "drag", 1.5, "N"
  carried_by, degree, depends_on = ("place",), "force_x", frozenset(("place_x", "place_y"))
  written = "F_x = -1.5 sgn(v) / (1 + d^2 / 0.25)^2, d from (0.3, 0.4)"
  value_of = staticmethod(
    lambda x: (
      -1.5 * np.tanh(x["speed"] / 0.05) / (1 + ((x["place_x"] - 0.3) ** 2 + (x["place_y"] - 0.4) ** 2) / 0.25) ** 2
    )
  )

  def load(self, sim) -> None:  # noqa: ANN001
    s, c = sim.dynamics.stage, self.columns
    away = (s.x[c] - 0.3) ** 2 + (s.y[c] - 0.4) ** 2
    sim.dynamics.wrench[0, c] -= self.value / (1 + away / 0.25) ** 2 * np.tanh(s.vx[c] / 0.05)


class BindingJoint(Hidden):
  """Joints of the drive shafts bind when the wheels are turned."""

  id, subsystem, parameter, typical, unit = "binding_joint", "drive", "torque", 0.06, "N m/rad^2"
  carried_by, degree, depends_on = ("commands",), "motor_torque", frozenset(("steering",))
  written = "T = -0.06 delta^2 sgn(v)"
  value_of = staticmethod(lambda x: -0.06 * x["steering"] ** 2 * np.tanh(x["speed"] / 0.05))

  def load(self, sim) -> None:  # noqa: ANN001
    s, c = sim.dynamics.stage, self.columns
    sim.dynamics.motor_torque[c] -= self.value * s.servo[c] ** 2 * np.tanh(s.vx[c] / 0.05)


class StrainedGyro(Hidden):
  """A gyro that feels the square of the acceleration across."""

  id, subsystem, parameter, typical, unit = "strained_gyro", "sensor", "error", 0.006, "rad s^3/m^2"
  carried_by, degree, depends_on = ("motion",), "reads_yaw_rate", frozenset(("accel_y",))
  written = "d_yaw_rate = 0.006 a_y^2"
  value_of = staticmethod(lambda x: 0.006 * x["accel_y"] ** 2)

  def sense(self, log) -> None:  # noqa: ANN001
    c = self.columns
    log.channels["yaw_rate"][:, c] += self.value * log.channels["accel_y"][:, c] ** 2


class YawPump(Hidden):
  """A yaw moment against the square of the yaw rate: much like less grip at the front, which a base can take in."""

  id, subsystem, parameter, typical, unit = "yaw_pump", "body", "moment", 0.03, "N m s^2/rad^2"
  carried_by, degree, depends_on = ("motion",), "moment_z", frozenset(("yaw_rate",))
  written = "M_z = -0.03 r |r|"
  value_of = staticmethod(lambda x: -0.03 * x["yaw_rate"] * np.abs(x["yaw_rate"]))

  def load(self, sim) -> None:  # noqa: ANN001
    s, c = sim.dynamics.stage, self.columns
    sim.dynamics.wrench[2, c] -= self.value * s.yaw_rate[c] * np.abs(s.yaw_rate[c])


@contextlib.contextmanager
def offered() -> Iterator[None]:
  """These effects among the independent car's, for as long as a session is made."""
  EFFECTS.update(FORMULAS)
  try:
    yield
  finally:
    for name in FORMULAS:
      EFFECTS.pop(name)


def concealed(seed: int, name: str, noise: float = 1.0) -> DataSet:
  """A compact session with one of FORMULAS, or "" for none."""
  with offered():
    session = make_session(seed, ((name, 1.0),) if name else (), "compact", noise)
  return DataSet(name or "nothing", session.recordings, session.vehicle, session.vehicle_std)


def true_base(seed: int) -> Prepared:
  """The base that a car's session without an effect gives."""
  return prepare(concealed(seed, ""), threads=1)


@dataclasses.dataclass(frozen=True)
class Tried:
  """One case.

  Attributes:
    shipped: what was found.
    seconds: that it took, of one core.
    error: root mean square difference to the true formula over what was driven, over that of the true one; NaN where
      nothing is shipped, or somewhere else.
    right_degree, right_variables: whether it acts where it should, on what it should; of what is shipped.
  """

  shipped: Shipped
  seconds: float
  error: float
  right_degree: bool
  right_variables: bool


def tried(base: Prepared, seed: int, name: str) -> Tried:
  """Look for the formula of one session at the car's true base."""
  pool, holdout = _at_base(base, ready(concealed(seed, name))[0])
  began = time.process_time()
  shipped = formula_left(pool, Decision("unexplained", (), (), (), None, ()), holdout, Cut())
  assert shipped is not None
  return _judged(shipped, FORMULAS.get(name), time.process_time() - began)


def _judged(shipped: Shipped, truth: type[Hidden] | None, seconds: float) -> Tried:
  rest, error = shipped.rest, np.nan
  if truth is None or not (shipped.kept and rest.sought and rest.twin and rest.sought.forms):
    return Tried(shipped, seconds, error, False, False)
  degree = rest.sought.recovered.degree
  along = degree in _ALONG and truth.degree in _ALONG
  if along or degree == truth.degree:
    driven = rest.sought.driven
    radius = rolling_radius(driven.car)
    lever = {"force_x": 1.0, "motor_torque": 1.0 / radius} if along else {}
    true = truth.value_of(driven.values) * lever.get(truth.degree, 1.0)
    off = said_by(rest) * lever.get(degree, 1.0) - true
    error = float(np.sqrt(np.mean(off**2) / np.mean(true**2)))
  law = frozenset(rest.twin.mechanism.law.variables) - ({"speed"} - truth.depends_on)
  return Tried(shipped, seconds, error, along or degree == truth.degree, law == truth.depends_on)


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
