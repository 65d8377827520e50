"""Effects of the steering: servo, linkage, column."""

from __future__ import annotations

import numpy as np

from ..simulation import Simulation
from .base import Effect, towards

DEGREE = np.pi / 180


class SteeringLag(Effect):
  """Second-order servo (damping 0.8) with a soft limit of its speed; parameter: 2 zeta / omega, the slow lag."""

  id, subsystem, parameter, typical, unit = "steering_lag", "steering", "steering_lag", 0.055, "s"

  def begin(self, sim: Simulation) -> None:
    self.rate = 2 * 0.8 / self.value
    self.angle, self.speed = sim.road[self.columns].copy(), np.zeros(sim.n)[self.columns]

  def act(self, sim: Simulation) -> None:
    goal = sim.command[1, self.columns]
    pull, h = self.rate**2 * (goal - self.angle), sim.h
    self.speed = (self.speed + h * pull) / (1 + 1.6 * self.rate * h + (self.rate * h) ** 2)  # stable at any rate
    self.speed = 25.0 * np.tanh(self.speed / 25.0)
    self.angle += sim.h * self.speed
    goal[:] = self.angle


class SteeringDelay(Effect):
  """The steering command waits in a ring of fine steps, the last fraction of a step by mixing two of them."""

  id, subsystem, parameter, typical, unit = "steering_delay", "steering", "steering_delay", 0.040, "s"
  row = 1

  def begin(self, sim: Simulation) -> None:
    length = int(np.ceil(self.value / sim.h)) + 1
    self.ring = np.repeat(sim.command[self.row, self.columns][None], length, axis=0)
    self.share, self.at = self.value / sim.h - (length - 2), 0

  def act(self, sim: Simulation) -> None:
    wanted, length = sim.command[self.row, self.columns], len(self.ring)
    self.ring[self.at] = wanted
    self.at = (self.at + 1) % length
    wanted[:] = self.share * self.ring[self.at] + (1 - self.share) * self.ring[(self.at + 1) % length]


class SteeringRateLimit(Effect):
  """The servo saturates: its speed is rho tanh(error / 0.03 rad), so never above rho = 1 / q; parameter: q.

  A worn one under load: half the speed that a standard servo has without a load (0.23 s for 60 degrees, S3003).
  """

  id, subsystem, parameter, typical, unit = "steering_rate_limit", "steering", "steering_inverse_rate", 0.45, "s/rad"

  def begin(self, sim: Simulation) -> None:
    self.angle = sim.road[self.columns].copy()

  def act(self, sim: Simulation) -> None:
    goal = sim.command[1, self.columns]
    most = sim.h / self.value
    self.angle += most * np.tanh((goal - self.angle) / max(0.03, most))
    goal[:] = self.angle


class SteeringOffset(Effect):
  """The horn sits askew on the servo's shaft: the road wheels stand off by an angle, a little less of it at lock."""

  id, subsystem, parameter, typical, unit, signed = (
    "steering_offset",
    "steering",
    "steering_offset",
    2 * DEGREE,
    "rad",
    True,
  )

  def link(self, sim: Simulation) -> None:
    road = sim.road[self.columns]
    road += self.value * np.cos(road)


class SteeringGainError(Effect):
  """A linkage arm of wrong length: tan(delta) = (1 + k) tan(u)."""

  id, subsystem, parameter, typical, unit, signed = (
    "steering_gain_error",
    "steering",
    "steering_gain_error",
    0.08,
    "-",
    True,
  )

  def link(self, sim: Simulation) -> None:
    road = sim.road[self.columns]
    road[:] = np.arctan((1 + self.value) * np.tan(road))


class SteeringAsymmetry(Effect):
  """Tie rods of unequal geometry: the gain goes over from 1 - a on the right to 1 + a on the left within a degree."""

  id, subsystem, parameter, typical, unit, signed = (
    "steering_asymmetry",
    "steering",
    "steering_asymmetry",
    0.10,
    "-",
    True,
  )

  def link(self, sim: Simulation) -> None:
    road = sim.road[self.columns]
    road *= 1 + self.value * np.tanh(road / (0.7 * DEGREE))


class SteeringNonlinearity(Effect):
  """The horn turns on a circle: delta = s sin(u / s), with s such that the share x is lost at full lock."""

  id, subsystem, parameter, typical, unit = "steering_nonlinearity", "steering", "steering_nonlinearity", 0.10, "-"

  def begin(self, sim: Simulation) -> None:
    lock = sim.car.max_steering[self.columns]
    ratio = np.sqrt(10 - np.sqrt(100 - 120 * self.value))  # sin(q)/q = 1 - q^2/6 + q^4/120 = 1 - x
    self.circle = lock / ratio

  def link(self, sim: Simulation) -> None:
    road = sim.road[self.columns]
    road[:] = self.circle * np.sin(road / self.circle)


class SteeringBacklash(Effect):
  """A pin in a slot: the wheels rest in it by friction, are carried by its edges (within 2 ms) and crawl to the side
  that the tyres push to."""

  id, subsystem, parameter, typical, unit = "steering_backlash", "steering", "steering_play", 1.5 * DEGREE, "rad"

  def begin(self, sim: Simulation) -> None:
    self.pin = sim.road[self.columns].copy()

  def link(self, sim: Simulation) -> None:
    c, half = self.columns, 0.5 * self.value
    road, force = sim.road[c], sim.dynamics.force[1, :2, c].sum(axis=0)
    self.pin -= sim.h * 0.25 * half * np.tanh(force)
    self.pin = towards(self.pin, np.clip(self.pin, road - half, road + half), sim.h, 2e-3)
    road[:] = self.pin


class SteeringDeadZone(Effect):
  """The servo's potentiometer is worn about its centre: a soft knee, b ln(1 + exp(.)) on either side."""

  id, subsystem, parameter, typical, unit = "steering_dead_zone", "steering", "steering_dead_zone", 1.5 * DEGREE, "rad"

  def act(self, sim: Simulation) -> None:
    wanted, soft = sim.command[1, self.columns], 0.1 * self.value
    left, right = np.logaddexp(0, (wanted - self.value) / soft), np.logaddexp(0, (-wanted - self.value) / soft)
    wanted[:] = soft * (left - right)


class SteeringQuantisation(Effect):
  """The servo sleeps until its error exceeds the band, then runs in at 8 rad/s until the error is a tenth of it."""

  id, subsystem, parameter, typical, unit = (
    "steering_quantisation",
    "steering",
    "steering_dead_band",
    0.75 * DEGREE,
    "rad",
  )

  def begin(self, sim: Simulation) -> None:
    self.angle = sim.road[self.columns].copy()
    self.awake = np.zeros(self.angle.shape, bool)

  def act(self, sim: Simulation) -> None:
    goal = sim.command[1, self.columns]
    error = goal - self.angle
    self.awake = np.where(self.awake, np.abs(error) > 0.1 * self.value, np.abs(error) > self.value)
    self.angle += self.awake * np.clip(error, -8.0 * sim.h, 8.0 * sim.h)
    goal[:] = self.angle


class SteeringCompliance(Effect):
  """The tyres' side force bends the linkage through a damper (8 ms); it stiffens by a fifth at 12 N."""

  id, subsystem, parameter, typical, unit = "steering_compliance", "steering", "steering_compliance", 8e-3, "rad/N"

  def begin(self, sim: Simulation) -> None:
    self.bent = np.zeros(sim.n)[self.columns]

  def link(self, sim: Simulation) -> None:
    force = sim.dynamics.force[1, :2, self.columns].sum(axis=0)
    self.bent = towards(self.bent, self.value * force / (1 + 0.2 * (force / 12.0) ** 2), sim.h, 8e-3)
    sim.road[self.columns] -= self.bent
