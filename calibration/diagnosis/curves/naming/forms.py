"""Which named form an identified curve has.

A fitted curve is a vector of heights at its knots with a covariance. Every mechanism that declares `outlined_by` that
curve is asked what it would do at the knots; its parameters are fitted to the heights by generalised least squares, and
what is left, chi-square distributed where the form is right, says whether it is one. Of the forms that are not refused
the one with the fewest parameters is the name; a curve that none fits has no known form, and is shipped as a table.
"""

import dataclasses
import itertools
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2

from calibration.diagnosis.curves.flexible import Characterised
from qcar_twin.plant import SIGNALS
from qcar_twin.twin.mechanisms import offered, select
from qcar_twin.twin.mechanisms.base import CarDimensions, Context, Mechanism
from qcar_twin.twin.mechanisms.elements import STANDSTILL
from qcar_twin.vehicle.vehicle import GRAVITY

Array = NDArray[np.float64]

LEVEL = 0.02  # share of right forms that are refused, and of absent departures that are taken for one
BENT = 0.2  # of what a departure is worth that a form may leave, to be nearly it: a stated prior, not calibrated
_CRAWLING = (0.01, 0.03)  # shares of the highest speed
_MOST = 2  # forms that one curve may be made of


@dataclasses.dataclass(frozen=True)
class Form:
  """Named mechanisms fitted to a curve.

  Attributes:
    mechanisms: ids.
    values, std: of their parameters.
    misfit: what is left: chi-square of the heights or, where the driving was asked, its error over the curve's.
    p_value: how often the right form leaves as much.
  """

  mechanisms: tuple[str, ...]
  values: Mapping[str, float]
  std: Mapping[str, float]
  misfit: float
  p_value: float


@dataclasses.dataclass(frozen=True)
class Outline:
  """An identified curve and its names.

  Attributes:
    curve: id.
    places: where its heights belong, in shares of the reach; heights, std: (k,), in the curve's own unit.
    departs: how improbable such heights are without any departure, a p-value.
    forms: all that were fitted, fewest parameters first and best first among equals.
    asked: curves of the car, among all of which chance may bring no more than LEVEL departures (Bonferroni).
    without: error of the twin with neither the curve nor a form over the one with the curve; 1 where the driving was
      not asked.
  """

  curve: str
  places: tuple[str, ...]
  heights: Array
  std: Array
  departs: float
  forms: tuple[Form, ...]
  asked: int = 1
  without: float = 1.0

  @property
  def is_there(self) -> bool:
    return self.departs * self.asked < LEVEL

  @property
  def possible(self) -> tuple[Form, ...]:
    """Forms that are not refused, the simplest first; () without a departure.

    One of them is right at most, and that one is asked once: that many are asked makes none of them likelier.
    """
    return tuple(form for form in self.forms if form.p_value >= LEVEL) if self.is_there else ()

  @property
  def named(self) -> Form | None:
    """The simplest form that is not refused."""
    return next(iter(self.possible), None)

  @property
  def nearly(self) -> Form | None:
    """Where all forms are refused, the simplest that leaves next to nothing of what the departure is worth."""
    if self.named or not self.is_there:
      return None
    return next((form for form in self.forms if self.left(form) <= BENT), None)

  @property
  def told(self) -> Form | None:
    """What is said of a departure: its name, or what it nearly is."""
    return self.named or self.nearly

  def left(self, form: Form) -> float:
    """Of the error that comes of leaving the departure out, the share that a form leaves; 1 where none was asked."""
    return (form.misfit - 1.0) / (self.without - 1.0) if self.without > 1.0 else 1.0


def left_with(outline: Outline, told: Collection[str]) -> Outline:
  """An outline whose name has only those mechanisms that are told of in the end; no departure, where none is."""
  form = outline.named
  if form is None or all(name in told for name in form.mechanisms):
    return outline
  rest = select([name for name in form.mechanisms if name in told])
  own = {p.name for mechanism in rest for p in mechanism.parameters}
  if not rest:
    return dataclasses.replace(outline, departs=1.0)
  kept = lambda values: {name: value for name, value in values.items() if name in own}
  names = tuple(m.name for m in rest)
  smaller = dataclasses.replace(form, mechanisms=names, values=kept(form.values), std=kept(form.std))
  # it takes the place of a like one that was refused alone, beside what had joined by then
  others = [f for f in outline.forms if f is not form and f.mechanisms != names]
  return dataclasses.replace(outline, forms=(smaller, *others))


def redrawn(drawn: Sequence[Outline], found: Characterised) -> tuple[Outline, ...]:
  """Outlines with the heights that their curves have in another fit of the same twin; what is said of them stays."""
  std = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
  at = lambda outline: [found.fitted.fit.parameters.index(name) for name in outline.places]
  return tuple(dataclasses.replace(o, heights=found.fitted.fit.theta[at(o)], std=std[at(o)]) for o in drawn)


def outlines(found: Characterised) -> list[Outline]:
  """Every curve of a characterised twin with the forms it may have."""
  covariance, parameters = found.covariance, found.fitted.fit.parameters
  named = offered(found.twin.vehicle.drive)
  made = []
  for name in found.curves:
    curve = found.fitted.problem.mechanism(name)
    family = [m for m in named if m.outlined_by == name and m.name not in found.beside]
    heights = [p for p in curve.parameters if p.null is not None]
    at = [parameters.index(p.name) for p in heights]
    values, spread = found.fitted.fit.theta[at], covariance[np.ix_(at, at)]
    made.append(_outline(found, curve, family, values, spread, [p.name for p in heights]))
  return made


def _outline(
  found: Characterised, curve: Mechanism, family: Sequence[Mechanism], heights: Array, covariance: Array,
  names: Sequence[str],
) -> Outline:  # fmt: skip
  project, nuisance = projection(found, curve)
  # the car's own gain, damping and friction trade with the straight part of a curve: nothing is known of that part
  wide = 1e6 * np.trace(covariance) * nuisance @ nuisance.T
  root = np.linalg.cholesky(covariance + wide + 1e-9 * np.trace(covariance) * np.eye(len(heights)))
  white = lambda x: np.linalg.solve(root, x)
  left = len(heights) - nuisance.shape[1]
  forms = []
  for count in range(1, _MOST + 1):
    for chosen in itertools.combinations(family, count):
      form = _fitted(chosen, project, white, heights, left)
      if form:
        forms.append(form)
  forms.sort(key=lambda f: (len(f.values), f.misfit))
  departs = float(chi2.sf(np.sum(white(heights) ** 2), left))
  return Outline(
    curve.name, tuple(names), heights, np.sqrt(np.diag(covariance)), departs, tuple(forms), len(found.curves)
  )


def _fitted(
  chosen: Sequence[Mechanism], project: Callable[[Sequence[Mechanism], Array], Array], white: Callable[[Array], Array],
  heights: Array, left: int,
) -> Form | None:  # fmt: skip
  """The forms fitted to the heights; None where they have as many parameters as the curve."""
  declared = [p for m in chosen for p in m.parameters]
  if len(declared) >= left:
    return None
  lower, upper = np.array([p.lower for p in declared]), np.array([p.upper for p in declared])
  residual = lambda theta: white(project(chosen, theta) - heights)
  starts = [
    [np.clip((p.null or 0.0) + sign * p.typical if p.typical else p.nominal, p.lower, p.upper) for p in declared]
    for sign in (0.5, -0.5)
  ]
  scale = np.array([p.scale for p in declared])
  tries = [least_squares(residual, np.clip(s, lower, upper), bounds=(lower, upper), x_scale=scale) for s in starts]
  best = min(tries, key=lambda t: t.cost)
  misfit = 2.0 * float(best.cost)
  spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(best.jac.T @ best.jac)), 0.0))
  names = [p.name for p in declared]
  return Form(
    tuple(m.name for m in chosen),
    dict(zip(names, best.x.tolist(), strict=True)),
    dict(zip(names, spread.tolist(), strict=True)),
    misfit,
    float(chi2.sf(misfit, left - len(declared))),
  )


def projection(found: Characterised, curve: Mechanism) -> tuple[Callable[[Sequence[Mechanism], Array], Array], Array]:
  """Heights of a curve that mechanisms with parameters amount to, and the heights of what the base car can do itself.

  Both sides are asked through their hooks at the same commands and speeds, as many as the curve has heights and more,
  and the curve is fitted to the answers by least squares.
  """
  commands, speeds = questions(found, curve)
  context = situation(found, commands, speeds)
  own = [p for p in curve.parameters if p.null is not None]
  fixed = [found.theta[found.twin.parameters.index(p.name)] for p in curve.parameters if p.null is None]
  unit = np.array([answer([curve], np.array([*row, *fixed]), context) for row in np.eye(len(own))]).T
  inverse = np.linalg.pinv(unit)
  project = lambda mechanisms, theta: inverse @ answer(mechanisms, theta, context)
  return project, inverse @ base_can(curve, commands, context)


def questions(found: Characterised, curve: Mechanism) -> tuple[Array, Array]:
  """Commands (n, 2) and speeds (n,) [m/s] at which a curve and its forms are compared: what was driven.

  Commands are in V, also of a car that is driven by a duty, or in A or m/s where the drive's is one, and in rad.
  """
  segments = found.fitted.problem.observations.stretches.segments
  inside = np.arange(segments.commands.shape[1]) < segments.steps[:, None]
  driven = segments.commands[inside] * [found.twin.vehicle.command_scale, 1.0]
  top = float(np.quantile(np.abs(segments.start[:, 3]), 0.995)) or 1.0
  lowest, highest = driven.min(axis=0), driven.max(axis=0)
  across = np.linspace(0.0, 1.0, 25)
  commands = np.zeros((len(across), 2))
  if curve.subsystem == "steering":
    commands[:, 1] = lowest[1] + across * (highest[1] - lowest[1])
    return commands, np.full(len(across), 0.5 * top)
  if curve.stage == "force":
    return np.zeros((len(across) + len(_CRAWLING), 2)), np.concatenate([_CRAWLING, across]) * top
  commands[:, 0] = max(lowest[0], 0.0) + across * (highest[0] - max(lowest[0], 0.0))
  return np.tile(commands, (3, 1)), np.repeat(np.array([0.0, 0.5, 1.0]) * top, len(across))


def base_can(curve: Mechanism, commands: Array, context: Context) -> Array:
  """What gain, damping and friction of the base car do at the questions, (n, k)."""
  if curve.subsystem == "steering":
    return np.zeros((len(commands), 0))
  speed = context.signal("velocity_x")
  if curve.stage == "force":
    return np.stack([speed, np.tanh(speed / STANDSTILL)], axis=1)
  back = context.motor_damping / context.torque_per_volt * context.signal("motor_speed")
  return np.stack([commands[:, 0], back], axis=1)


def answer(mechanisms: Sequence[Mechanism], theta: Array, context: Context) -> Array:
  """What mechanisms, one after the other, change at the questions, (n,): rad, V, or shares of the weight."""
  size, used = len(context.commands), 0
  acting, force = context.commands.copy(), np.zeros(size)
  for mechanism in mechanisms:
    own = np.tile(theta[used : used + len(mechanism.parameters)], (size, 1))
    used += len(mechanism.parameters)
    if mechanism.stage == "force":
      force += mechanism.wrench(own, context, mechanism.initial(own, context))[:, 0]
    else:
      acting = mechanism.command(own, context, mechanism.initial(own, context), acting)
  if mechanisms[0].stage == "force":
    return -force / (GRAVITY * context.car.mass)
  return (acting - context.commands)[:, 1 if mechanisms[0].subsystem == "steering" else 0]


def situation(found: Characterised, commands: Array, speeds: Array) -> Context:
  twin, size = found.twin, len(commands)
  car: CarDimensions = twin.car
  values = twin.parameters.named(found.theta)
  signals = np.zeros((size, len(SIGNALS)))
  signals[:, SIGNALS.index("velocity_x")] = speeds
  signals[:, SIGNALS.index("motor_speed")] = speeds / (car.wheel_radius * car.gear_ratio)
  constant = lambda value: np.full(size, float(value))
  return Context(
    car=car, period=twin.period, time=1.0, signals=signals, commands=commands, history=np.zeros((size, 2)),
    recording_time=constant(1.0), pose=np.zeros((size, 3)), wheel_angle=np.zeros(size),
    torque_per_volt=constant(values[twin.vehicle.motor.gain]), motor_damping=constant(values["motor_damping"]),
  )  # fmt: skip
