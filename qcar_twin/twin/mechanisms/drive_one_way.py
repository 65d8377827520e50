"""Speed controller of a model car: a transistor drives, diodes carry the rest, and it brakes by short circuit."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import idle_voltage, ramp

CORNER = 0.02  # V
NEUTRAL = 0.02  # of the supply, stated prior: twice a step of pulses that are told in hundredths
STANDS = 0.1  # V of back-EMF, stated prior: what a controller takes for a motor that stands
_EITHER = 1.0 / 3.0  # any share may be: all of it is three deviations


class DriveOneWay(Mechanism):
  """The controller drives one way only: it does not brake while it drives, and brakes by short circuit when told to.

  Equation: with u and e (back-EMF) counted along the motion, u' = u + x max(e - u, 0) where u drives (diodes stop what
  would flow back) and u' = u + z max(e - u, 0) at neutral, w = 1 / (1 + (u / 0.02 U)^4). A command backwards brakes a
  car that rolls forwards: u' = u + y (e (1 - (1 - g) |u| / U) - u), the motor is shorted for |u| / U of the time; it
  does not drive it backwards before it was told neutral. One forwards always drives.
  Units: x, y, z, g -: 0 is four quadrants and a short circuit at neutral; U V, of the supply; u, e V.
  Source: Hughes and Drury, Electric Motors and Drives, 4th ed., 2013, ch. 4 (chopper drives of one and two quadrants).
  Size: stated prior: 0.5 is the middle of the range from 0 to 1. Any is usual, so every model fits all of it, and no
    diagnosis names it.
  Confounded with: drive_limit, drive_asymmetry, coast_freewheel, motor damping.
  """

  name = "drive_one_way"
  subsystem = "drive"
  stage = "actuator"
  link = "device"
  fitted_rank = 25
  drives = ("duty",)
  whole = ("drive_one_way", "drive_one_way_brake", "drive_one_way_neutral", "drive_one_way_weakness")
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
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """What kind of controller follows a duty few descriptions of a car say."""
    return {p.name: _EITHER for p in self.parameters}

  def initial(self, theta: Array, context: Context) -> State:
    """What stands under a command backwards is held by the brake, but where it was told so just now."""
    told = context.commands[:, 0]
    before = told if context.before is None else context.before[:, -1, 0]
    least = np.fmax(told, before)  # what nobody knows was the same
    neutral, moves = self._told(context, least)
    return {"brakes": ((neutral < 0.5) & (least < 0.0) & (moves < 0.5)).astype(np.float64)}

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    u, e = command[:, 0], idle_voltage(context)
    neutral, moves = self._told(context, u)
    way = np.where(e < 0.0, -1.0, 1.0)
    along, back = u * way, e * way
    # what arrives late may be neutral where nobody knows what was told before
    least = np.minimum(u, context.commands[:, 0])
    asked = (least < 0.0) & (self._told(context, least)[0] < 0.5)
    held = asked & ((state["brakes"] > 0.5) | ((e > 0.0) & (moves > 0.5)))
    state["brakes"] = held.astype(np.float64)
    shorted = np.minimum(np.abs(u) / context.car.duty_supply, 1.0) * (1.0 - theta[:, 3])
    stopped = ramp(back - along, CORNER)
    braking = theta[:, 1] * np.maximum(moves, held) * (back * (1.0 - shorted) - along)
    driving = np.where(along >= 0.0, theta[:, 0] * stopped, 0.0)
    told = np.where(((u < 0.0) & (e > 0.0)) | held, braking, driving)
    acting = command.copy()
    acting[:, 0] = u + way * (neutral * theta[:, 2] * stopped + (1.0 - neutral) * told)
    return acting

  @staticmethod
  def _told(context: Context, command: Array) -> tuple[Array, Array]:
    """How far commands are neutral, and how far motors move, (n,) each, 0 to 1."""
    ratio = np.minimum(np.abs(command) / (NEUTRAL * context.car.duty_supply), 1e3) ** 2
    back = idle_voltage(context) ** 2
    return 1.0 / (1.0 + ratio * ratio), back / (back + STANDS**2)
