"""Effects of motor, battery and driveline."""

from __future__ import annotations

import numpy as np

from .base import Effect
from .steering import SteeringDelay


class DriveDelay(SteeringDelay):
  """The voltage waits in a ring of fine steps."""

  id, subsystem, parameter, typical, unit = "drive_delay", "drive", "delay", 0.035, "s"
  row = 0


class QuadraticDrag(Effect):
  """Drag of a stirred fluid film, F = c v_1^0.25 abs(v)^1.75 with v_1 = 1.5 m/s: equal to c v^2 there."""

  id, subsystem, parameter, typical, unit = "quadratic_drag", "body", "drag", 0.40, "kg/m"

  def load(self, sim):
    v = sim.dynamics.stage.vx[self.columns]
    sim.dynamics.wrench[0, self.columns] -= self.value * 1.5**0.25 * np.sign(v) * np.abs(v) ** 1.75


class Payload(Effect):
  """A box on the deck behind the centre of gravity; pose marker and IMU stay where they are on the chassis."""

  id, subsystem, parameter, typical, unit = "payload", "body", "mass", 0.55, "kg"
  AFT = 0.03  # m behind the empty car's centre of gravity

  def prepare(self, car):
    c = self.columns
    total = car.mass[c] + self.value
    shift = self.value / total * self.AFT
    car.yaw_inertia[c] += car.mass[c] * self.value / total * self.AFT**2 + self.value * 0.0012
    car.mass[c] = total
    car.cg_to_front[c] += shift
    car.cg_to_rear[c] -= shift
    car.imu_x[c] += shift
    car.marker_x[c] += shift

  def truth(self):
    return {"mass": self.value, "position_x": -self.AFT}
