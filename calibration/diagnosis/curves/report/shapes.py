"""Identified curves in physical units: road angle over command, torque over command and speed, resistance over speed.

Gain, damping and friction of the base car trade with the straight part of a curve. What is drawn as the base law is
therefore the one of all base cars that comes nearest to the curve by least squares, and a departure is what is left
between the two; forms are treated alike, so that they lie on the curve where they fit it.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.curves.flexible import Characterised
from calibration.diagnosis.curves.naming.forms import Form, Outline, answer, base_can, questions, situation
from qcar_twin.kinematics import rolling_radius
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.mechanisms.base import Context, Mechanism
from qcar_twin.twin.mechanisms.elements import STANDSTILL, idle_voltage
from qcar_twin.vehicle.vehicle import GRAVITY

Array = NDArray[np.float64]

BAND = 1.96  # standard deviations: 95 % of a Gaussian
_STEADY = 3.0 * STANDSTILL  # m/s: below it a resistance fades out towards rest, and nothing of it is seen


@dataclasses.dataclass(frozen=True)
class View:
  """A curve along one axis.

  Attributes:
    heading: at what speed, where that matters.
    x: command or speed, (n,); law: of the nearest base car, (n,).
    departure, std: of the curve from that law, (n,).
    forms: departure of each form that may be its name, the named one first, or of what it nearly is, (n,).
  """

  heading: str
  x: Array
  law: Array
  departure: Array
  std: Array
  forms: Mapping[str, Array]


@dataclasses.dataclass(frozen=True)
class Shape:
  """A curve with its views; units are those of the axes' titles.

  Attributes:
    curve: id.
    part: what of the car it is, in a word.
    x_title, y_title: of the axes; x_unit, y_unit: as in a sentence.
  """

  curve: str
  part: str
  x_title: str
  y_title: str
  x_unit: str
  y_unit: str
  views: tuple[View, ...]

  @property
  def clearest(self) -> tuple[float, float, float]:
    """The departure whose band keeps farthest from zero, its deviation, and where it is: y, y, x."""
    sure = lambda v: np.abs(v.departure) - BAND * v.std
    view = max(self.views, key=lambda v: float(np.max(sure(v))))
    at = int(np.argmax(sure(view)))
    return float(view.departure[at]), float(view.std[at]), float(view.x[at])


@dataclasses.dataclass(frozen=True)
class _Axes:
  """How the answers of a kind of curve are drawn: x and the base car's law at the questions, y per answer."""

  part: str
  titles: tuple[str, str]
  units: tuple[str, str]
  x: Array
  law: Array
  scale: float


def shapes(found: Characterised, outlines: Sequence[Outline]) -> tuple[Shape, ...]:
  """The curves of a characterised twin where it was driven, in the order of their outlines."""
  covariance = found.covariance
  return tuple(_shape(found, outline, covariance) for outline in outlines)


def _shape(found: Characterised, outline: Outline, covariance: Array) -> Shape:
  curve = found.fitted.problem.mechanism(outline.curve)
  commands, speeds = questions(found, curve)
  context = situation(found, commands, speeds)
  own = [p.name for p in curve.parameters if p.null is not None]
  fixed = [found.theta[found.twin.parameters.index(p.name)] for p in curve.parameters if p.null is None]
  unit = np.array([answer([curve], np.array([*row, *fixed]), context) for row in np.eye(len(own))]).T
  at = [found.fitted.fit.parameters.index(name) for name in own]
  basis = base_can(curve, commands, context)
  nearest = basis @ np.linalg.pinv(basis)
  axes = _axes(found, curve, commands, speeds, context)
  law = axes.law + axes.scale * nearest @ unit @ outline.heights
  left = axes.scale * (unit - nearest @ unit)
  drawn, spread = left @ outline.heights, left @ covariance[np.ix_(at, at)] @ left.T
  std = np.sqrt(np.maximum(np.diag(spread), 0.0))
  forms: dict[str, Array] = {}
  for form in outline.possible or ([outline.nearly] if outline.nearly else []):
    acting = answer(*_made_of(form), context)
    forms[" and ".join(form.mechanisms)] = axes.scale * (acting - nearest @ acting)
  views = []
  levels = np.unique(speeds) if curve.stage == "actuator" else [None]
  for level in levels:
    rows = np.flatnonzero(speeds == level) if level is not None else np.flatnonzero(_seen(curve, speeds))
    heading = "" if level is None else f"at {level:.2g} m/s"
    kept = {name: y[rows] for name, y in forms.items()}
    views.append(View(heading, axes.x[rows], law[rows], drawn[rows], std[rows], kept))
  return Shape(outline.curve, axes.part, *axes.titles, *axes.units, tuple(views))


def _seen(curve: Mechanism, speeds: Array) -> NDArray[np.bool_]:
  return speeds >= min(_STEADY, 0.5 * float(speeds.max())) if curve.stage == "force" else np.full(len(speeds), True)


def _made_of(form: Form) -> tuple[Sequence[Mechanism], Array]:
  mechanisms = select(form.mechanisms)
  return mechanisms, np.array([form.values[p.name] for m in mechanisms for p in m.parameters])


def _axes(found: Characterised, curve: Mechanism, commands: Array, speeds: Array, context: Context) -> _Axes:
  twin, vehicle = found.twin, found.twin.vehicle
  if curve.subsystem == "steering":
    angle = np.degrees(commands[:, 1])
    titles = ("steering command, left positive [°]", "road wheels' angle [°]")
    return _Axes("steering", titles, ("° of command", "°"), angle, angle, float(np.degrees(1.0)))
  if curve.stage == "force":
    values, travel = twin.parameters.named(found.theta), rolling_radius(vehicle)
    motor = 0.0 if vehicle.drive == "speed" else values["motor_damping"] * speeds / travel  # a loop's gain is no loss
    lost = (values["driveline_friction"] * np.tanh(speeds / STANDSTILL) + motor) / travel
    lost += vehicle.rolling_resistance * vehicle.mass * GRAVITY * np.tanh(speeds / STANDSTILL)
    titles = ("speed [m/s]", "force against the motion [N]")
    return _Axes("resistance", titles, ("m/s", "N"), speeds, lost, GRAVITY * context.car.mass)
  gain, motor = float(context.torque_per_volt[0]), vehicle.motor
  unit = "" if motor.unit == "-" else f" {motor.unit}"
  titles = (f"{motor.channel.replace('_', ' ')}{f' [{motor.unit}]' if unit else ''}", "motor torque [mN m]")
  law = 1e3 * gain * (commands[:, 0] - idle_voltage(context))
  return _Axes(
    "drive", titles, (unit.strip() or "of full duty", "mN m"), commands[:, 0] / vehicle.command_scale, law, 1e3 * gain
  )
