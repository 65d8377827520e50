"""Figures of the QCar's class, carried over to cars of another size.

Two cars of one shape that corner alike under the same gravity are similar in Froude's sense: with lengths by k, their
speeds and times go by sqrt(k), masses and forces by k^3 and moments by k^4, while accelerations, angles and slips stay
(Langhaar, Dimensional Analysis and Theory of Models, 1951, ch. 5; of vehicles: Brennan and Alleyne, Using a scale
testbed: controls design and evaluation, IEEE Control Systems Magazine 21, 2001).

A figure that stands for a class is no better known than to a factor of two. So k is the ratio of the wheelbases in
whole octaves, towards the QCar: from half to twice its length, from 1:20 to 1:5, every figure is as it is.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping

from qcar_twin.parameters import Parameter

WHEELBASE = 0.256  # m, of the QCar
# of the wheelbase, by which measured numbers grow from car to car: lengths in proportion, mass as in a least-squares
# line through cars from 1:43 to full size (docs/reference/sizes.md), yaw inertia as mass x length^2
POWERS = {"mass": 2.73, "yaw_inertia": 4.73, "cg_to_front": 1.0, "cg_to_rear": 1.0, "track_width": 1.0,
          "cg_height": 1.0, "wheel_radius": 1.0}  # fmt: skip
_LONGEST_STEP = 0.005  # s, for which suspension and contacts of a QCar are made stable; environments use it
_SAME = 1e-9  # octaves: a wheelbase of exactly twice the QCar's is twice it, whatever its last bit


@dataclasses.dataclass(frozen=True)
class Similarity:
  """How figures of the QCar's class are carried over: by these factors.

  Attributes:
    length: k, a whole power of two.
  """

  length: float

  @classmethod
  def of(cls, wheelbase: float) -> "Similarity":
    """Of a car with this wheelbase, m."""
    octaves = math.log2(wheelbase / WHEELBASE)
    return cls(2.0 ** math.trunc(octaves + math.copysign(_SAME, octaves)))

  @property
  def time(self) -> float:
    return math.sqrt(self.length)

  @property
  def speed(self) -> float:
    return self.length / self.time

  @property
  def mass(self) -> float:
    return self.length**3

  @property
  def longest_step(self) -> float:
    """Longest step a car stands, s: as many to its shortest times as the QCar has, never longer than the QCar's.

    Wheels, springs and tyres of a small car are as much quicker as its time is shorter.
    """
    return _LONGEST_STEP * min(self.time, 1.0)

  def steps(self, substeps: int) -> int:
    """Steps of a control period for a car of this size, from those of the QCar's class."""
    return math.ceil(substeps / min(self.time, 1.0) - _SAME)

  def carried(self, parameter: Parameter, unit: str | None = None) -> Parameter:
    """A parameter with its figures carried over by its unit, or as what has the given unit is; itself where that says
    nothing of size."""
    by = _BY_UNIT.get(unit or parameter.unit)
    slow = parameter.unit == "s" and parameter.null is None  # how long what changes takes (heat, charge), not a lag
    if by is None or self.length == 1.0 or slow:
      return parameter
    factor = by(self)
    moved: Mapping[str, float | None] = {
      name: None if (value := getattr(parameter, name)) is None else factor * value
      for name in ("nominal", "lower", "upper", "null", "std", "typical", "step", "start")
    }
    return dataclasses.replace(parameter, **moved)  # type: ignore[arg-type]


def estimates(said: Mapping[str, float], figures: Mapping[str, float]) -> dict[str, float]:
  """Numbers of a car that nobody said, from those of another and from the wheelbase.

  Args:
    said: measured numbers by name of the vehicle's field, cg_to_front and cg_to_rear among them.
    figures: the same of a car whose shape is taken for this one's, all of POWERS.

  Returns:
    those of POWERS that were not said; a said mass gives the yaw inertia in proportion.
  """
  size = (said["cg_to_front"] + said["cg_to_rear"]) / (figures["cg_to_front"] + figures["cg_to_rear"])
  grown = {name: figures[name] * size**power for name, power in POWERS.items()}
  grown["yaw_inertia"] *= said.get("mass", grown["mass"]) / grown["mass"]
  return {name: value for name, value in grown.items() if name not in said}


_BY_UNIT: Mapping[str, Callable[[Similarity], float]] = {
  "m": lambda s: s.length,
  "m/s": lambda s: s.speed,
  "s": lambda s: max(s.time, 1.0),  # a lag or delay: a large car's are longer, but electronics don't shrink
  "s/rad": lambda s: s.time,
  "kg": lambda s: s.mass,
  "kg/m": lambda s: s.mass / s.length,
  "kg m^2": lambda s: s.mass * s.length**2,
  "N": lambda s: s.mass,
  "N m": lambda s: s.mass * s.length,
}
AS_THE_QCAR = Similarity(1.0)
