"""Changes of a car that a watch looks out for: each one or several parameters of the twin, at a size worth an alarm."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.twin.mechanisms import select
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
  """

  name: str
  words: str
  size: float
  factors: tuple[str, ...] = ()
  shifts: tuple[str, ...] = ()
  unit: str = "%"
  scale: float = 100.0
  both: bool = True

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
  Change("sag", "battery sag", 0.2, shifts=("battery_sag",), both=False),
  Change("steering_delay", "steering delay", 0.04, shifts=("steering_delay",), unit="ms", scale=1e3, both=False),
  Change("steering_offset", "steering trim", 0.03, shifts=("steering_offset",), unit="mrad", scale=1e3),
)
_NEEDED = ("battery_sag", "steering_delay", "steering_offset")


def watching(twin: Twin, theta: Array) -> tuple[Twin, Array]:
  """The twin with the mechanisms that changes need, at their null where it had none, on the reduced car if it can."""
  present = {m.name for m in twin.mechanisms}
  added = select([name for name in _NEEDED if name not in present])
  made = twin.with_mechanisms((*twin.mechanisms, *added))
  try:
    made = made.on("reduced")
  except ValueError:
    pass  # the reduced car lacks something this car has: MuJoCo is fast enough for one
  values: Mapping[str, float] = twin.parameters.named(theta)
  nulls = {p.name: p.nominal if p.null is None else p.null for m in added for p in m.parameters}
  return made, made.parameters.vector({**nulls, **values})


def variants(twin: Twin, theta: Array, changes: Sequence[Change] = CHANGES) -> Array:
  """The twin itself, then with each change, (1 + K, P)."""
  return np.stack([theta, *(change.at(twin, theta, change.size) for change in changes)])
