"""Mechanisms that go by how a car moves in a form that an engine knows: whole runs are driven without asking them."""

import numpy as np

from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State
from qcar_twin.twin.mechanisms.elements import idle_voltage


class Resisting(Mechanism):
  """A force against the motion that grows with the square of the speed."""

  def drag(self, theta: Array) -> Array:
    """c of F = -c |v| v, kg/m, (n,), from parameters (n, p)."""
    raise NotImplementedError

  def wrench(self, theta: Array, context: Context, state: State) -> Array:
    ahead, aside = context.signal("velocity_x"), context.signal("velocity_y")
    factor = -self.drag(theta) * np.sqrt(ahead * ahead + aside * aside)
    force = np.zeros((len(theta), 3))
    force[:, 0], force[:, 1] = factor * ahead, factor * aside
    return force


class Weakening(Mechanism):
  """A motor with shares of its flux, m, and of its conductance, f: for a voltage u there acts e + (u - e m) m f, e
  the back-EMF that it would have with all of its flux."""

  def weakened(self, theta: Array, commands: Array, period: float, state: State) -> Array:
    """m and f in periods with logged drive commands (T, n), (T, n, 2), from parameters (n, p); changes `state`."""
    raise NotImplementedError

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting, idle = command.copy(), idle_voltage(context)
    flux, conductance = self.weakened(theta, context.commands[None, :, 0], context.period, state)[0].T
    acting[:, 0] = idle + (command[:, 0] - idle * flux) * flux * conductance
    return acting
