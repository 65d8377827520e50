"""N cars driven one control period at a time, with concealed effects; keeps the fine history the sensors read."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from ..laboratory.manoeuvres import PERIOD
from .car import GRAVITY
from .dynamics import Dynamics, rolling_start
from .electronics import Electronics

TRACE = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "accel_x", "accel_y", "motor", "motor_angle", "road")
HOOKS = ("act", "link", "load", "contact")
SENSOR_ERRORS = (
    "imu_delay", "pose_delay", "pose_drift", "gyro_gain", "imu_twist",
    "accel_bias_x", "accel_bias_y", "gyro_bias", "bias_walk", "pose_turn", "pose_ahead", "pose_aside",
)  # fmt: skip


class Concealed(Protocol):
  """What the simulation asks of an effect; see effects.base.Effect for what each hook may change."""

  def implements(self, hook: str) -> bool: ...
  def prepare(self, car: SimpleNamespace) -> None: ...
  def begin(self, sim: Simulation) -> None: ...
  def act(self, sim: Simulation) -> None: ...
  def link(self, sim: Simulation) -> None: ...
  def load(self, sim: Simulation) -> None: ...
  def contact(self, sim: Simulation) -> None: ...
  def sense(self, log: Any) -> None: ...


@dataclass
class Carried:
  """What a session's earlier runs leave to each run, arrays (N,), and the session as a whole."""

  heat: np.ndarray  # K of the armature above the room
  used: np.ndarray  # C taken from the pack
  elapsed: np.ndarray  # s since the session began
  session_length: np.ndarray  # s
  session_charge: np.ndarray  # C
  session_loss: np.ndarray  # W, mean over the driving

  @classmethod
  def fresh(cls, n: int) -> Carried:
    """A cold car with a full pack, and round numbers for its session."""
    nothing = np.zeros(n)
    return cls(nothing, nothing, nothing, np.full(n, 600.0), np.full(n, 100.0), np.full(n, 1.5))


class Simulation:
  """State of N cars under way. Public: dynamics, command (2, N) [V, rad], road (N,) [rad], heat (N,) [K], used (N,)
  [C], time [s] of the run.
  """

  def __init__(self, car: SimpleNamespace, effects: tuple[Concealed, ...] = (), substep: float = 1e-3) -> None:
    for name in SENSOR_ERRORS:
      setattr(car, name, np.zeros(len(car.mass)))
    for effect in effects:
      effect.prepare(car)
    self.car, self.effects, self.h = car, effects, substep
    self.dynamics = Dynamics(car)
    self.electronics = Electronics(self.dynamics, car.drivetrain)
    n = self.n = self.dynamics.n
    self.substeps = round(PERIOD / substep)
    self.stride = max(1, self.substeps // 5)  # the trace is kept every 2 ms
    self.hooks = {name: [effect for effect in effects if effect.implements(name)] for name in HOOKS}
    self.dynamics.loads = [_bound(effect.load, self) for effect in self.hooks["load"]]
    self.dynamics.contacts = [_bound(effect.contact, self) for effect in self.hooks["contact"]]
    self.command, self.road = np.zeros((2, n)), np.zeros(n)
    self.carried = Carried.fresh(n)
    self.heat, self.used, self.time = np.zeros(n), np.zeros(n), 0.0
    self.trace, self.filled = np.zeros((1, len(TRACE), n)), 1

  def begin(
    self, start: np.ndarray, held: np.ndarray | None = None, carried: Carried | None = None, ticks: int = 0
  ) -> None:
    """Set the cars at start (N, 7), with `held` (2, N) [V, rad] commanded for long enough before, and what earlier runs
    left. The trace has room for `ticks` periods; after that its last row is written over."""
    rolling_start(self.dynamics, start)
    self.carried = carried or self.carried
    self.heat[:], self.used[:], self.time = self.carried.heat, self.carried.used, 0.0
    self.command[:] = np.stack([np.zeros(self.n), start[:, 6]]) if held is None else held
    self.road[:] = self.dynamics.state.servo
    for effect in self.effects:
      effect.begin(self)
    self.dynamics.voltage[:] = self.command[0]
    self.electronics.begin()
    self.electronics.apply(self.command[0], 1.0 - self.car.discharge * self.used / self.car.charge, 0.0)
    self.dynamics.stage.array[:] = self.dynamics.state.array
    self.dynamics.derivative()
    self.trace, self.filled = np.empty((1 + ticks * self.substeps // self.stride, len(TRACE), self.n)), 0
    self._keep()

  def advance(self, command: np.ndarray, disturbance: np.ndarray | None = None) -> None:
    """Hold command (2, N) [V, or what the drivetrain takes; rad] for one period. `disturbance` (7, N): N, N, N m on the
    body, relative loads."""
    d = self.dynamics
    if disturbance is not None:
      moving = np.tanh(np.abs(d.state.vx) / 0.15)
      np.multiply(disturbance[:3], moving, out=d.noise_wrench)
      d.unevenness[:] = 1.0 + disturbance[3:] * moving
    for index in range(self.substeps):
      self._inputs(command)
      d.step(self.h)
      self._warm()
      self.time += self.h
      if (index + 1) % self.stride == 0:
        self._keep()

  def _inputs(self, command: np.ndarray) -> None:
    """From logged commands to what servo and motor get."""
    d, car = self.dynamics, self.car
    self.command[:] = command
    if self.hooks["act"]:
      d.grip[:], d.conduct[:], d.constant[:] = 1.0, 1.0, car.motor_constant
    d.resistance[:] = car.motor_resistance * (1.0 + car.copper * self.heat)
    for effect in self.hooks["act"]:
      effect.act(self)
    left = 1.0 - car.discharge * self.used / car.charge
    d.voltage[:] = self.command[0] * left
    self.electronics.apply(self.command[0], left, self.h)
    np.clip(self.command[1], -car.max_steering, car.max_steering, out=d.steer_target)
    self.road[:] = d.state.servo
    for effect in self.hooks["link"]:
      effect.link(self)
    if self.hooks["link"]:
      np.subtract(self.road, d.state.servo, out=d.bend)

  def _warm(self) -> None:
    """Heat of the armature [K] and charge taken from the pack [C]."""
    d, car = self.dynamics, self.car
    loss = d.current**2 * d.resistance - self.heat / car.heat_resistance
    self.heat += self.h * loss / car.heat_capacity
    self.used += self.h * np.abs(d.current * d.voltage) / 11.1

  def _keep(self) -> None:
    """Add a row to the trace."""
    self.filled = min(self.filled + 1, len(self.trace))
    self.trace[self.filled - 1] = self._row()

  def _row(self) -> np.ndarray:
    """One row of the trace (11, N): truth at this instant, accelerations at the IMU."""
    d, s, car = self.dynamics, self.dynamics.state, self.car
    spin = d.rate.yaw_rate
    a_x = d.acceleration[0] - spin * car.imu_y - s.yaw_rate**2 * car.imu_x - GRAVITY * s.pitch
    a_y = d.acceleration[1] + spin * car.imu_x - s.yaw_rate**2 * car.imu_y + GRAVITY * s.roll
    return np.stack([s.x, s.y, s.yaw, s.vx, s.vy, s.yaw_rate, a_x, a_y, s.motor, s.motor_angle, s.servo + d.bend])


def _bound(hook, sim: Simulation):
  """A hook of an effect as the dynamics call it."""
  return lambda _dynamics: hook(sim)
