"""Effects of the steering: servo, linkage, column."""

from __future__ import annotations

import numpy as np

from .base import Effect

DEGREE = np.pi / 180


class SteeringLag(Effect):
  """Second-order servo with a soft limit on its rate; parameter: first moment of its step response, 2 zeta / omega."""

  id, subsystem, parameter, typical, unit = "steering_lag", "steering", "equivalent_delay", 0.055, "s"

  def begin(self, sim):
    self.rate = 2 * 0.8 / self.value
    self.angle, self.speed = sim.road[self.columns].copy(), np.zeros(sim.n)[self.columns]

  def act(self, sim):
    goal = sim.command[1, self.columns]
    pull = self.rate**2 * (goal - self.angle) - 1.6 * self.rate * self.speed
    self.speed += sim.h * pull
    self.speed = 25.0 * np.tanh(self.speed / 25.0)
    self.angle += sim.h * self.speed
    goal[:] = self.angle


class SteeringDelay(Effect):
  """The steering command waits in a ring of fine steps."""

  id, subsystem, parameter, typical, unit = "steering_delay", "steering", "delay", 0.040, "s"
  row = 1

  def begin(self, sim):
    self.ring = np.repeat(sim.command[self.row, self.columns][None], int(np.ceil(self.value / sim.h)) + 1, axis=0)
    self.share = self.value / sim.h - (len(self.ring) - 2)
    self.at = 0

  def act(self, sim):
    wanted = sim.command[self.row, self.columns]
    self.ring[self.at] = wanted
    oldest, next_oldest = self.ring[(self.at + 1) % len(self.ring)], self.ring[(self.at + 2) % len(self.ring)]
    wanted[:] = self.share * oldest + (1 - self.share) * next_oldest
    self.at = (self.at + 1) % len(self.ring)


class SteeringOffset(Effect):
  """The horn sits askew on the servo's shaft: the road wheels stand off by an angle, a little less of it at lock."""

  id, subsystem, parameter, typical, unit, signed = "steering_offset", "steering", "offset", 2 * DEGREE, "rad", True

  def link(self, sim):
    road = sim.road[self.columns]
    road += self.value * np.cos(road)
