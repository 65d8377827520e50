"""Changes of a car that a watch looks out for, and what differs from day to day without anything being wrong.

Each is one or several parameters of the twin, a change at a size worth an alarm, what is ordinary at one deviation.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.twin import Twin

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Change:
  """One kind of change.

  Attributes:
    name: id.  words: what is said, with the size in `unit`.
    factors: parameters that are multiplied by 1 + size.  shifts: parameters to which the size is added.
    size: at which it is worth an alarm; the alarm is for either sign where `both`.
    scale: of the size in what is printed (100 for per cent).
    possible: least and largest size that a car can have; beyond, something else is wrong: a stated prior of factors,
      the catalogue's bounds of what is added.
  """

  name: str
  words: str
  size: float
  factors: tuple[str, ...] = ()
  shifts: tuple[str, ...] = ()
  unit: str = "%"
  scale: float = 100.0
  both: bool = True
  possible: tuple[float, float] = (-0.95, 3.0)

  def at(self, twin: Twin, theta: Array, size: float) -> Array:
    """The twin's parameters (P,) with the change, within bounds."""
    made, known = theta.copy(), twin.parameters
    for name in self.factors:
      made[known.index(name)] *= 1.0 + size
    for name in self.shifts:
      made[known.index(name)] += size
    return np.clip(made, known.lower, known.upper)


CHANGES = (
  Change(
    "grip", "grip", -0.2, ("friction_coefficient", "cornering_stiffness_front", "cornering_stiffness_rear"), both=True
  ),
  Change("rear_grip", "rear cornering stiffness", -0.2, ("cornering_stiffness_rear",)),
  Change("front_grip", "front cornering stiffness", -0.2, ("cornering_stiffness_front",)),
  Change("sag", "battery sag", 0.2, shifts=("battery_sag",), both=False, possible=(0.0, 2.0)),
  Change(
    "steering_delay",
    "steering delay",
    0.04,
    shifts=("steering_delay",),
    unit="ms",
    scale=1e3,
    both=False,
    possible=(0.0, 0.2),
  ),
  Change(
    "steering_offset", "steering trim", 0.03, shifts=("steering_offset",), unit="mrad", scale=1e3, possible=(-0.2, 0.2)
  ),
)
_NEEDED = ("battery_sag", "steering_delay", "steering_offset")
_ZEROS = ("gyro_bias", "accel_bias")  # mechanisms whose biases a sensor has anew whenever it is switched on


def watching(twin: Twin, theta: Array) -> tuple[Twin, Array]:
  """The twin with the mechanisms that changes need, at their null where it had none, on the reduced car if it can."""
  present = {m.name for m in twin.mechanisms}
  missing = (catalogue()[name] for name in (*_NEEDED, *_ZEROS) if name not in present)
  added = tuple(m for m in missing if twin.vehicle.drive in m.drives)
  made = twin.with_mechanisms((*twin.mechanisms, *added))
  try:
    made = made.on("reduced")
  except ValueError:
    pass  # the reduced car lacks something this car has: MuJoCo is fast enough for one
  values: Mapping[str, float] = twin.parameters.named(theta)
  nulls = {p.name: p.nominal if p.null is None else p.null for m in added for p in m.parameters}
  return made, made.parameters.vector({**nulls, **values})


def known_to(twin: Twin, changes: Sequence[Change]) -> tuple[Change, ...]:
  """Those that the twin has parameters for: a drive by current knows no battery sag."""
  return tuple(c for c in changes if {*c.factors, *c.shifts} <= set(twin.parameters.names))


def ordinary(twin: Twin) -> tuple[Change, ...]:
  """What differs from day to day: zeros of gyro and accelerometers, and what the battery's charge leaves of a volt.

  Deviations are those of the catalogue: of a gyro's zero once it was read at rest, of an accelerometer's usual bias,
  and what a battery typically loses over a session. A motor's warm winding is within the latter.
  """
  known = catalogue()
  errors = {name: error for m in _ZEROS for name, error in known[m].sensor_errors.items()}
  made = [Change(name, name, error.wander or error.std, shifts=(name,)) for name, error in errors.items()]
  discharge = known["battery_discharge"]
  (loss,) = (p.typical for p in discharge.parameters if p.name == discharge.name)
  if twin.vehicle.drive in discharge.drives and loss is not None:
    gain = twin.vehicle.motor.gain
    made.append(Change(gain, gain, -loss, factors=(gain,)))
  return known_to(twin, made)


def variants(twin: Twin, theta: Array, changes: Sequence[Change] = CHANGES) -> Array:
  """The twin itself, then with each change, (1 + K, P)."""
  return np.stack([theta, *(change.at(twin, theta, change.size) for change in changes)])
