"""Speed controller of a model car: a transistor drives, diodes carry the rest, and it brakes by short circuit."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.engines import controller
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import EITHER, idle_voltage


class DriveOneWay(Mechanism):
  """The controller drives one way only: it does not brake while it drives, and brakes by short circuit when told to.

  Equation: with u and e (back-EMF) counted along the motion, u' = u + x max(e - u, 0) where u drives (diodes stop what
  would flow back) and u' = u + z max(e - u, 0) at neutral, w = 1 / (1 + (u / 0.02 U)^4). A command backwards brakes a
  car that rolls forwards: u' = u + y (e (1 - (1 - g) |u| / U) - u), the motor is shorted for |u| / U of the time; it
  does not drive it backwards before it was told neutral. One forwards always drives. A controller without reverse
  brakes by any command backwards: of what acts then it is the share n.
  Units: x, y, z, g, n -: 0 is four quadrants and a short circuit at neutral; U V, of the supply; u, e V.
  Source: Hughes and Drury, Electric Motors and Drives, 4th ed., 2013, ch. 4 (chopper drives of one and two quadrants).
  Size: stated prior: 0.5 is the middle of the range from 0 to 1. Any is usual, so every model fits all of it, and no
    diagnosis names it.
  Confounded with: drive_limit, drive_asymmetry, coast_freewheel, motor damping.
  """

  name = "drive_one_way"
  subsystem = "drive"
  stage = "contact"
  fitted_rank = 25
  drives = ("duty",)
  whole = (
    "drive_one_way",
    "drive_one_way_brake",
    "drive_one_way_neutral",
    "drive_one_way_weakness",
    "drive_one_way_reverse",
  )
  parameters = (
    Parameter(
      "drive_one_way", 0.0, 0.0, 1.0, "-", "x", null=0.0, typical=0.5, description="no braking while it drives"
    ),
    Parameter(
      "drive_one_way_brake", 0.0, 0.0, 1.0, "-", "y", null=0.0, typical=0.5, description="braking by short circuit"
    ),
    Parameter(
      "drive_one_way_neutral", 0.0, 0.0, 1.0, "-", "z", null=0.0, typical=0.5, description="letting go at neutral"
    ),
    Parameter(
      "drive_one_way_weakness",
      0.0,
      0.0,
      1.0,
      "-",
      "g",
      null=0.0,
      typical=0.5,
      description="strength that the brake lacks",
    ),
    Parameter("drive_one_way_reverse", 0.0, 0.0, 1.0, "-", "n", null=0.0, typical=0.5, description="no reverse"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """What kind of controller follows a duty few descriptions of a car say."""
    return {p.name: EITHER for p in self.parameters}

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    for name, share in zip(controller.QUANTITIES, theta.T, strict=True):
      model.set(name, model.get(name) + share)
    told = context.commands[:, 0]
    higher = told if context.before is None else np.fmax(told, context.before[:, -1, 0])  # NaN: it was told the same
    model.set("braked_at_first", controller.at_first(higher, idle_voltage(context), context.car.duty_supply))
