"""The independent car as a plant that a controller can be closed around, one 10 ms period at a time."""

from __future__ import annotations

import numpy as np

from ..laboratory.manoeuvres import PERIOD
from .car import Car, fleet
from .effects import effect_class
from .session import FORCE_NOISE, LOAD_NOISE
from .simulation import TRACE, Simulation

COLUMNS = [TRACE.index(name) for name in TRACE if name != "motor_angle"]


class Drive:
  """N cars under way. `signals` (N, 10): pose x, y [m], yaw [rad], velocity x, y [m/s], yaw rate [rad/s], acceleration
  x, y at the IMU [m/s^2], motor speed [rad/s], mean road-wheel angle [rad]; true values, no sensor noise."""

  def __init__(self, sim: Simulation, noise: float, rng: np.random.Generator) -> None:
    self._sim, self._noise, self._rng = sim, noise, rng
    self._drift = np.zeros((7, sim.n))
    self.signals = sim.trace[-1][COLUMNS].T.copy()

  def step(self, commands: np.ndarray) -> np.ndarray:
    """Hold commands (N, 2) [V, rad] for one period; the signals (N, 10) after it."""
    commands = np.asarray(commands, float)
    if commands.shape != (self._sim.n, 2):
      raise ValueError(
        f"commands must be ({self._sim.n}, 2): voltage [V], steering [rad] for each car, got {commands.shape}"
      )
    self._sim.advance(commands.T, self._disturbance())
    self.signals = self._sim.trace[-1][COLUMNS].T.copy()
    return self.signals

  def _disturbance(self) -> np.ndarray | None:
    """Coloured forces and load errors, as in a session."""
    if not self._noise:
      return None
    memory = np.array([FORCE_NOISE[1]] * 3 + [LOAD_NOISE[1]] * 4)[:, None]
    size = np.array([*FORCE_NOISE[0], *[LOAD_NOISE[0]] * 4])[:, None]
    keep = np.exp(-PERIOD / memory)
    self._drift = keep * self._drift + np.sqrt(1 - keep**2) * self._rng.standard_normal(self._drift.shape)
    return self._noise * size * self._drift


class ProvingGroundPlant:
  """N copies of one car, concealed effects if wanted. `effects`: (id, size) pairs; `noise`: factor on process noise."""

  period = PERIOD

  def __init__(
    self, car: Car | None = None, effects: tuple[tuple[str, float], ...] = (), noise: float = 0.0, seed: int = 0
  ) -> None:
    self.car, self.effects, self.noise, self.seed = car or Car(), tuple(effects), noise, seed
    for name, _ in self.effects:
      effect_class(name)

  def begin(self, start: np.ndarray) -> Drive:
    """Cars at start (N, 7): pose x, y [m], yaw [rad], velocity x, y [m/s], yaw rate [rad/s], steering angle [rad];
    wheels rolling.
    """
    start = np.atleast_2d(np.asarray(start, float))
    if start.shape[1] != 7:
      raise ValueError(f"start must be (N, 7), got {start.shape}")
    rng = np.random.default_rng([self.seed, 0])
    every = slice(0, len(start))
    hidden = tuple(effect_class(name)(size, every, rng) for name, size in self.effects if size)
    sim = Simulation(fleet([self.car], [len(start)]), hidden)
    sim.begin(start)
    return Drive(sim, self.noise, rng)
