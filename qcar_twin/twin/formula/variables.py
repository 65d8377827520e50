"""What a formula may be a function of: states, commands and places of a car, each with its unit and its own scale.

In units of its scale a variable is a dimensionless number of the car: v / sqrt(g L), r sqrt(L / g), a / g, x / L, an
angle over the lock (Langhaar, Dimensional Analysis and Theory of Models, 1951, ch. 5).
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin.mechanisms.base import CarDimensions, Context
from qcar_twin.twin.mechanisms.elements import idle_voltage
from qcar_twin.vehicle.vehicle import GRAVITY

Array = NDArray[np.float64]


class View(Protocol):
  """A moment, or a whole rollout: what `Context` and `Track` have in common."""

  @property
  def car(self) -> CarDimensions: ...
  def signal(self, name: str) -> Array:
    """One of the signals by name."""
    ...


@dataclasses.dataclass(frozen=True)
class Variable:
  """One argument of a formula.

  Attributes:
    words: what a report calls it.
    symbol: in an equation.
    unit: powers of base units and of N, V, W and rad, by name.
    value: in that unit, from a moment.
    scale: its natural size for a car; None where the driven range has to say.
    width: share of the scale over which its sign turns.
    angular: only its sine and cosine have a meaning.
    needs: "signals", "commands" (of which a sensor knows nothing), or "pose".
    memory: seconds over which it is a leaky mean; 0 for the present.
  """

  words: str
  symbol: str
  unit: Mapping[str, int]
  value: Callable[[View], Array]
  scale: Callable[[CarDimensions], float] | None
  width: float = 0.02
  angular: bool = False
  needs: str = "signals"
  memory: float = 0.0


def _speed_scale(car: CarDimensions) -> float:
  return float(np.sqrt(GRAVITY * car.wheelbase))


def _signal(name: str) -> Callable[[View], Array]:
  return lambda view: view.signal(name)


def _pose(column: int, name: str) -> Callable[[View], Array]:
  """Measured where known, as the context has it; a sensor's own car is simulated."""
  return lambda view: view.pose[..., column] if isinstance(view, Context) else view.signal(name)


def _command(view: View) -> Array:
  assert isinstance(view, Context)
  return view.commands[:, 0]


def _wheel(view: View) -> Array:
  assert isinstance(view, Context)
  return view.wheel_angle


def _drive_power(view: View) -> Array:
  """Torque of the motor at its speed, W, without sign."""
  assert isinstance(view, Context)
  torque = view.torque_per_volt * (view.commands[:, 0] - idle_voltage(view))
  return np.abs(torque * view.signal("motor_speed"))


def _slip_power(view: View) -> Array:
  """What cornering costs at most, m |a_y v|, W."""
  return view.car.mass * np.abs(view.signal("accel_y") * view.signal("velocity_x"))


def _power_scale(car: CarDimensions) -> float:
  return car.mass * GRAVITY * _speed_scale(car)


MEMORIES = (0.3, 3.0, 10.0)  # s


def _span(memory: float) -> str:
  """300ms, 3s: letters and digits only, since a term names it."""
  return f"{memory:g}s" if memory >= 1.0 else f"{1000.0 * memory:g}ms"


VARIABLES: dict[str, Variable] = {
  "speed": Variable("speed", "v", {"m": 1, "s": -1}, _signal("velocity_x"), _speed_scale),
  "yaw_rate": Variable("yaw rate", "r", {"rad": 1, "s": -1}, _signal("yaw_rate"),
                       lambda car: float(np.sqrt(GRAVITY / car.wheelbase))),
  "accel_x": Variable("longitudinal acceleration", "a_x", {"m": 1, "s": -2}, _signal("accel_x"), lambda car: GRAVITY),
  "accel_y": Variable("lateral acceleration", "a_y", {"m": 1, "s": -2}, _signal("accel_y"), lambda car: GRAVITY),
  "steering": Variable("road-wheel angle", "delta", {"rad": 1}, _signal("steering_angle"),
                       lambda car: car.max_steering),
  "drive": Variable("drive command", "u", {"u": 1}, _command, None, needs="commands"),
  "place_x": Variable("place", "x", {"m": 1}, _pose(0, "pose_x"), lambda car: car.wheelbase, needs="pose"),
  "place_y": Variable("place", "y", {"m": 1}, _pose(1, "pose_y"), lambda car: car.wheelbase, needs="pose"),
  "heading": Variable("heading", "psi", {"rad": 1}, _pose(2, "pose_yaw"), lambda car: 1.0, angular=True, needs="pose"),
  "wheel_angle": Variable("angle of the wheels", "theta", {"rad": 1}, _wheel, lambda car: 1.0, angular=True,
                          needs="commands"),
  **{f"drive_power_{_span(memory)}": Variable(f"drive power of the last {memory:g} s", f"P_{memory:g}",
                                          {"W": 1}, _drive_power, _power_scale, needs="commands", memory=memory)
     for memory in MEMORIES},
  **{f"slip_power_{_span(memory)}": Variable(f"cornering power of the last {memory:g} s", f"S_{memory:g}",
                                         {"W": 1}, _slip_power, _power_scale, memory=memory)
     for memory in MEMORIES},
}  # fmt: skip


def spell(unit: Mapping[str, int], drive_unit: str = "V") -> str:
  """A unit in words: {"N": 1, "s": 1, "rad": -1} is N s/rad."""
  named = [(drive_unit if name == "u" else name, power) for name, power in unit.items() if power]
  written = lambda name, power: name if power == 1 else f"{name}^{power}"
  above = " ".join(written(name, power) for name, power in named if power > 0)
  below = " ".join(written(name, -power) for name, power in named if power < 0)
  return f"{above or '1'}/{below}" if below and " " not in below else f"{above or '1'}/({below})" if below else above
