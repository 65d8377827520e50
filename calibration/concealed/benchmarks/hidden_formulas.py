"""Formulas that are nobody's but the generators', hidden in the independent cars alone; no campaign draws one."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from calibration.concealed.proving_ground import EFFECTS, make_session
from calibration.concealed.proving_ground.effects.outside import Outside
from calibration.concealed.second_car import make_second_session
from calibration.concealed.second_car.simulation import Simulation
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.formula.degrees import BODY, DEGREES

Array = NDArray[np.float64]
FORMULAS: dict[str, type["Hidden"]] = {}


class Hidden(Outside):
  """Base: an effect of this file, which no campaign draws.

  Class attributes: `degree` (where it acts), `depends_on` (variables), `written` (its formula), `value_of` (its value
  in the degree's unit from the twin's variables, for size 1).
  """

  degree: ClassVar[str]
  depends_on: ClassVar[frozenset[str]]
  written: ClassVar[str]
  value_of: ClassVar[Callable[[Mapping[str, Array]], Array]]

  @classmethod
  def push(cls, sim: Simulation) -> Array:
    """On the second car's body, (3, n) [N, N, N m]."""
    s, out = sim.state, np.zeros((3, sim.n))
    states = {"speed": s.u, "yaw_rate": s.r, "place_x": s.x, "place_y": s.y, "heading": s.yaw}
    if cls.degree in BODY:
      out[BODY.index(cls.degree)] = cls.value_of(states)
    return out

  @classmethod
  def misread(cls, channels: dict[str, np.ndarray]) -> None:
    """In the second car's channels (T, n)."""
    signal = DEGREES[cls.degree].signal
    if signal:
      channels[signal] += cls.value_of(channels)

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


class Grain(Hidden):
  """A carpet laid at an angle drags more one way than the other."""

  id, subsystem, parameter, typical, unit = "grain", "ground", "drag", 0.7, "N"
  carried_by, degree, depends_on = ("heading",), "force_x", frozenset(("heading",))
  written = "F_x = -0.7 cos(2 (psi - 0.6)) sgn(v)"
  value_of = staticmethod(lambda x: -0.7 * np.cos(2.0 * (x["heading"] - 0.6)) * np.tanh(x["speed"] / 0.05))

  def load(self, sim) -> None:  # noqa: ANN001
    s, c = sim.dynamics.stage, self.columns
    sim.dynamics.wrench[0, c] -= self.value * np.cos(2.0 * (s.yaw[c] - 0.6)) * np.tanh(s.vx[c] / 0.05)


class LeaningAccelerometer(Hidden):
  """An accelerometer whose mount bends under acceleration across."""

  id, subsystem, parameter, typical, unit = "leaning_accelerometer", "sensor", "error", 0.03, "s^2/m"
  carried_by, degree, depends_on = ("motion",), "reads_accel_x", frozenset(("accel_y",))
  written = "d_accel_x = 0.03 a_y^2"
  value_of = staticmethod(lambda x: 0.03 * x["accel_y"] ** 2)

  def sense(self, log) -> None:  # noqa: ANN001
    c = self.columns
    log.channels["accel_x"][:, c] += self.value * log.channels["accel_y"][:, c] ** 2


SECOND = tuple(n for n, kind in FORMULAS.items() if kind.degree in BODY or DEGREES[kind.degree].signal)


@contextlib.contextmanager
def offered() -> Iterator[None]:
  """These effects among the independent car's, for as long as a session is made."""
  EFFECTS.update(FORMULAS)
  try:
    yield
  finally:
    for name in FORMULAS:
      EFFECTS.pop(name)


def concealed(seed: int, name: str, noise: float = 1.0, car: str = "first") -> DataSet:
  """A compact session with one of FORMULAS, or "" for none.

  Args:
    seed: of the car and of all that is random.
    name: of FORMULAS; of SECOND for the second car, into whose motor nothing is hidden.
    noise: factor on what is random.
    car: "first" or "second" independent car.
  """
  if car == "second":
    hidden = FORMULAS.get(name)
    push, misread = (hidden.push, hidden.misread) if hidden else (None, None)
    session = make_second_session(seed, (), "compact", noise, push=push, misread=misread)
  else:
    with offered():
      session = make_session(seed, ((name, 1.0),) if name else (), "compact", noise)
  return DataSet(name or "nothing", session.recordings, session.vehicle, session.vehicle_std)
