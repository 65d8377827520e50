"""The second car as a plant that a controller can be closed around, one 10 ms period at a time."""

from __future__ import annotations

import numpy as np

from ..laboratory.driver import coloured
from ..laboratory.manoeuvres import PERIOD
from ..laboratory.written import stream
from .car import SecondCar
from .effects import conceal
from .floor import Floor
from .session import DRAUGHT, MOVING
from .simulation import FINE, SIGNALS, Simulation, columns

COLUMNS = [SIGNALS.index(name) for name in SIGNALS if name != "motor_angle"]


class Drive:
  """N cars under way. `signals` (N, 10): pose x, y [m], yaw [rad], velocity x, y [m/s], yaw rate [rad/s], acceleration
  x, y at the IMU [m/s^2], motor speed [rad/s], mean road-wheel angle [rad]; true values, no sensor noise."""

  def __init__(self, simulation: Simulation, draught: np.ndarray) -> None:
    """`draught` (T, 3, N) [N, N, N m]: on the body in every period."""
    self._simulation, self._draught = simulation, draught
    self.signals = simulation.trace[0][COLUMNS].T.copy()

  def step(self, commands: np.ndarray) -> np.ndarray:
    """Hold commands (N, 2) [V, rad] for one period; the signals (N, 10) after it.

    Raises:
      ValueError: commands of another shape.
      IndexError: more periods than the plant was made for.
    """
    simulation, commands = self._simulation, np.asarray(commands, float)
    if commands.shape != (simulation.n, 2):
      raise ValueError(
        f"commands must be ({simulation.n}, 2): voltage [V], steering [rad] for each car, got {commands.shape}"
      )
    if simulation.tick == len(self._draught):
      raise IndexError(f"the drive ends after {PERIOD * simulation.tick:g} s; give the plant more `seconds`")
    slow = np.minimum(np.abs(simulation.state.u) / MOVING, 1.0)
    simulation.advance(commands.T, self._draught[simulation.tick] * slow)
    self.signals = simulation.trace[FINE * simulation.tick][COLUMNS].T.copy()
    return self.signals


class SecondCarPlant:
  """N copies of one second car, concealed effects if wanted.

  `effects`: (id, size) pairs; `noise`: factor on floor and draught; `seconds`: longest drive.
  """

  period = PERIOD

  def __init__(
    self,
    car: SecondCar | None = None,
    effects: tuple[tuple[str, float], ...] = (),
    noise: float = 0.0,
    seed: int = 0,
    seconds: float = 60.0,
  ) -> None:
    self.car, self.effects, self.noise, self.seed, self.seconds = (
      car or SecondCar(),
      tuple(effects),
      noise,
      seed,
      seconds,
    )

  def begin(self, start: np.ndarray) -> Drive:
    """Cars at start (N, 7): pose x, y [m], yaw [rad], velocity x, y [m/s], yaw rate [rad/s], steering angle [rad];
    wheels rolling.

    Raises:
      ValueError: starts of another shape.
    """
    start = np.atleast_2d(np.asarray(start, float))
    if start.shape[1] != 7:
      raise ValueError(f"start must be (N, 7), got {start.shape}")
    n, ticks, seed = len(start), round(self.seconds / PERIOD), self.seed
    driven, _ = conceal(self.car, tuple(e for e in self.effects if e[1]), stream(seed, 100))
    size, memory = DRAUGHT
    draught = self.noise * coloured(stream(seed, 4), (ticks, 3, n), memory) * np.array(size)[:, None]
    held = np.stack([np.zeros(n), start[:, 6]])
    table = columns(driven, n, self.car.mass)
    floor = Floor(stream(seed, 7), self.noise)
    return Drive(Simulation(table, floor, start, held, ticks, stream(seed, 9)), draught)
