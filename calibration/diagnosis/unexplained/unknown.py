"""UNKNOWN as a rival: a smooth force on one degree of freedom, or a smooth error of one sensor.

Each is a general function of a few variables, sum_k c_k b_k(x), with b_k the monomials up to second
degree of variables squashed into (-1, 1). Coefficients start from a zero-mean prior of the typical
size, and the rival is cross-validated like every other model. If it beats all the catalogue, the
physics is not in the catalogue.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.unexplained.families import monomials, motion, terms
from calibration.fitting.observations import Observations
from qcar_twin.parameters import Parameter
from qcar_twin.plant import Prediction
from qcar_twin.twin.mechanisms.base import Context, Mechanism, State
from qcar_twin.vehicle.similarity import Similarity

Array = NDArray[np.float64]

_SCALES = {"speed": 1.5, "yaw_rate": 1.5, "steering": 0.25, "voltage": 2.0}  # m/s, rad/s, rad, V; of the QCar's class
_DEGREES = {
  "force_x": (("speed", "steering", "voltage"), 0.4, "N"),
  "force_y": (("speed", "yaw_rate", "steering"), 0.4, "N"),
  "moment_z": (("speed", "yaw_rate", "steering"), 0.03, "N m"),
  "voltage": (("speed", "voltage", "steering"), 0.12, "V"),
  "steering": (("steering", "speed", "yaw_rate"), 0.02, "rad"),
}
_WAYS = ("pose_forward", "pose_left", "path_forward", "path_left")  # no sensor's own reading
SUBSYSTEM = {"force_x": "body", "force_y": "tyre", "moment_z": "tyre", "voltage": "drive", "steering": "steering"}


class SmoothForce(Mechanism):
  """F(x) = sum_k c_k b_k(x) on one degree of freedom; b_k are the monomials up to degree two of squashed variables.

  Force [N], moment [N m], voltage [V] or steering angle [rad]; vanishes with the speed at standstill.
  """

  stage = "force"
  subsystem = "body"
  symmetric = False
  signed = True

  def __init__(self, degree: str):
    self.degree = degree
    self.variables, typical, unit = _DEGREES[degree]
    self.terms = terms(len(self.variables))
    parameters = tuple(
      Parameter(f"unknown_{degree}_{_term_name(self.variables, term)}", 0.0, -8 * typical, 8 * typical, unit,
                null=0.0, std=2 * typical, typical=typical)
      for term in self.terms
    )  # fmt: skip
    # what is a class's in other mechanisms is an object's here: one class, five degrees of freedom
    vars(self).update(name=f"unknown_{degree}", subsystem=SUBSYSTEM[degree], parameters=parameters)

  def _value(self, theta: Array, context: Context) -> Array:
    basis = monomials([_variable(name, context) for name in self.variables], self.terms)  # (n, K)
    slow = 0.1 * Similarity.of(context.car.wheelbase).speed
    moving = np.tanh((np.abs(context.signal("velocity_x")) / slow) ** 2)
    return moving * np.sum(theta * basis, axis=1)

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    if self.degree not in ("voltage", "steering"):
      return command
    out = command.copy()
    out[:, 0 if self.degree == "voltage" else 1] += self._value(theta, context)
    return out

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    out = np.zeros((len(theta), 3))
    if self.degree not in ("voltage", "steering"):
      out[:, ("force_x", "force_y", "moment_z").index(self.degree)] = self._value(theta, context)
    return out


def smooth_forces() -> tuple[Mechanism, ...]:
  """One unknown force for every degree of freedom."""
  return tuple(SmoothForce(degree) for degree in _DEGREES)


def unknown_sensors(
  base: Candidate, observations: Observations, prediction: Prediction, whitening: Array
) -> dict[str, Candidate]:
  """Fitted rivals in which one sensor channel has a smooth error of speed, yaw rate and accelerations.

  Linear in the coefficients, so no simulation is needed.

  Args:
    base: the recalibrated twin.
    observations: what was measured.
    prediction: the twin's signals under it, one vector.
    whitening: factor from each value's unit to nats, (M,).
  """
  grid = motion(observations, prediction)
  basis = grid.reshape(-1, grid.shape[-1])[observations.grid_points]  # at every measured value, (M, K)
  read = [name for name in observations.present if name not in _WAYS]
  return {f"unknown_sensor_{name}": _sensor_rival(base, observations, basis, whitening, name) for name in read}


def _sensor_rival(
  base: Candidate, observations: Observations, basis: Array, whitening: Array, channel: str
) -> Candidate:
  rows = observations.select(channel)
  scale = float(np.std(observations.measured[rows])) + 1e-12
  columns = basis * np.where(rows, 0.1 * scale * whitening, 0.0)[:, None]
  free = base.free + [
    Parameter(f"unknown_sensor_{channel}_{k}", 0.0, -100.0, 100.0, "-", null=0.0, std=1.0, typical=1.0)
    for k in range(basis.shape[1])
  ]
  values = np.concatenate([base.values, np.zeros(basis.shape[1])])
  rival = Candidate((f"unknown_sensor_{channel}",), free, base.theta, base.residual.copy(),
                    np.hstack([base.jacobian, columns]), values, base.n_train)  # fmt: skip
  unit = free.scale
  move = (
    -np.linalg.solve(rival.curvature * np.outer(unit, unit) + 1e-9 * np.eye(len(unit)), rival.gradient * unit) * unit
  )
  rival.values = values + move
  rival.residual = base.residual + rival.jacobian @ move
  return rival


def _variable(name: str, context: Context) -> Array:
  value = {
    "speed": lambda: context.signal("velocity_x"),
    "yaw_rate": lambda: context.signal("yaw_rate"),
    "steering": lambda: context.commands[:, 1],
    "voltage": lambda: context.commands[:, 0],
  }[name]()
  similarity = Similarity.of(context.car.wheelbase)
  scale = _SCALES[name] * {"speed": similarity.speed, "yaw_rate": 1.0 / similarity.time}.get(name, 1.0)
  return np.tanh(value / scale)


def _term_name(variables: Sequence[str], term: tuple[int, ...]) -> str:
  return "_".join(variables[i] for i in term) or "constant"
