"""A formula in the twin: a mechanism made of a law, whichever degree of freedom it acts on."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.formula.degrees import BODY, DEGREES
from qcar_twin.twin.formula.law import Law
from qcar_twin.twin.formula.table import Table
from qcar_twin.twin.formula.variables import VARIABLES, View
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State, Track
from qcar_twin.twin.mechanisms.elements import replaced
from qcar_twin.vehicle.similarity import Similarity

_SLOW = 0.1  # m/s of a car of the QCar's size: below it a force fades out


class Formula(Mechanism):
  """F = sum_k c_k b_k(x), bounded, on one degree of freedom; the b_k are those of its law.

  A subclass declares `law` and one parameter per term; of a law near a place three more, its x, y and radius. At rest
  every force vanishes, beyond the driven range each variable is held, and |F| stays below the law's limit: what the car
  gains by it per metre is bounded, and so is its speed.
  """

  signed = True
  law: ClassVar[Law | Table]

  def initial(self, theta: Array, context: Context) -> State:
    kept = sorted(name for name in self.law.variables if VARIABLES[name].memory)
    return {name: VARIABLES[name].value(context) for name in kept}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    return commanded(self.law.degree, context, command, lambda: self._value(theta, context, state))

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    return pushed(self.law.degree, len(theta), lambda: self._value(theta, context, state))

  def measure(self, theta: Array, track: Track) -> Array:
    signal = DEGREES[self.law.degree].signal
    if not signal:
      return track.signals
    kept = sorted(name for name in self.law.variables if VARIABLES[name].memory)
    state = {name: leaky(VARIABLES[name].value(track), VARIABLES[name].memory / track.period) for name in kept}
    values = {n: state[n] if n in state else VARIABLES[n].value(track) for n in self.law.variables}
    return replaced(track, **{signal: track.signal(signal) + self._bounded(theta[:, None], values, track)})

  def _value(self, theta: Array, context: Context, state: State) -> Array:
    values = {}
    for name in self.law.variables:
      values[name] = VARIABLES[name].value(context)
      if VARIABLES[name].memory:
        keep = np.exp(-context.period / VARIABLES[name].memory)
        values[name] = state[name] = keep * state[name] + (1.0 - keep) * values[name]
    return self._bounded(theta, values, context)

  def _bounded(self, theta: Array, values: Mapping[str, Array], view: View) -> Array:
    basis = self.law.basis(values, widths(view.car, self.law))
    value = np.sum(theta[..., : basis.shape[-1]] * basis, axis=-1)
    if isinstance(self.law, Law) and self.law.near:
      value = value * near(view, theta[..., basis.shape[-1] :])
    if DEGREES[self.law.degree].fades:
      value = value * moving(view)
    return np.clip(value, -self.law.limit, self.law.limit)


def commanded(degree: str, context: Context, command: Array, value: Callable[[], Array]) -> Array:
  """Commands (n, 2) with what acts on a degree of freedom, (n,): a motor's torque as voltage, or a wheels' angle."""
  if degree not in ("motor_torque", "steering_angle"):
    return command
  out = command.copy()
  if degree == "motor_torque":
    out[:, 0] += value() / context.torque_per_volt
  else:
    out[:, 1] += value()
  return out


def pushed(degree: str, count: int, value: Callable[[], Array]) -> Array:
  """Forces and yaw moment on the body, (count, 3), of what acts on a degree of freedom, (count,)."""
  out = np.zeros((count, 3))
  if degree in BODY:
    out[:, BODY.index(degree)] = value()
  return out


def moving(view: View) -> Array:
  """tanh((v / v_0)^2): 0 at rest, 1 from a walk on."""
  slow = _SLOW * Similarity.of(view.car.wheelbase).speed
  return np.tanh((view.signal("velocity_x") / slow) ** 2)


def near(view: View, place: Array) -> Array:
  """exp(-d^2 / 2 radius^2) of places (..., 3): x, y, radius [m]."""
  x, y = (VARIABLES[name].value(view) for name in ("place_x", "place_y"))
  away = (x - place[..., 0]) ** 2 + (y - place[..., 1]) ** 2
  return np.exp(-0.5 * away / np.maximum(place[..., 2], 1e-3) ** 2)


def widths(car: CarDimensions, law: Law | Table) -> dict[str, float]:
  """Over which the sign of each variable turns, in its unit: a share of its scale, of the driven range where it has
  none."""
  out = {}
  for name in law.variables:
    variable = VARIABLES[name]
    span = max(map(abs, law.ranges[name])) if isinstance(law, Law) else max(map(abs, law.knots[name]))
    out[name] = variable.width * (variable.scale(car) if variable.scale else span)
  return out


def leaky(values: Array, steps: float) -> Array:
  """First-order mean of values (..., T) over the last steps, from the first value on."""
  out, keep = np.empty_like(values), np.exp(-1.0 / steps)
  out[..., 0] = values[..., 0]
  for k in range(1, values.shape[-1]):
    out[..., k] = keep * out[..., k - 1] + (1.0 - keep) * values[..., k]
  return out


def limited(formula: Formula, limit: float) -> Formula:
  """The same with another largest magnitude, in the degree's unit."""
  return made(formula.name, dataclasses.replace(formula.law, limit=limit), formula.parameters)


def made(name: str, law: Law | Table, parameters: Sequence[Parameter]) -> Formula:
  """A mechanism of a law.

  Args:
    name: its id.
    law: what it is.
    parameters: one per term, each null at 0; three more of a law near a place.

  Raises:
    ValueError: their number does not fit.
  """
  degree, wanted = DEGREES[law.degree], len(law.terms) + (3 if isinstance(law, Law) and law.near else 0)
  if len(parameters) != wanted:
    raise ValueError(f"mechanism '{name}' has {len(parameters)} parameters for {wanted} numbers of its law")
  body = {"name": name, "law": law, "subsystem": degree.subsystem, "stage": degree.stage,
          "parameters": tuple(parameters), "__doc__": f"{degree.words.capitalize()} without a name."}  # fmt: skip
  return type("FoundFormula", (Formula,), body)()
