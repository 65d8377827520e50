"""The second car's runs side by side under commands, one control period at a time; scipy's Bogacki-Shampine pair 3(2).

The step follows the local error (Bogacki and Shampine, Appl. Math. Lett. 2(4), 1989) and ends where a command arrives.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from scipy.integrate import RK23

from ..laboratory.manoeuvres import PERIOD
from .car import GRAVITY, NOMINAL_PACK, SecondCar
from .chassis import Chassis
from .floor import Floor
from .states import NAMES, SCALES, State
from .steering import mean_angle

SIGNALS = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "accel_x", "accel_y", "motor", "motor_angle", "road")
FINE = 5  # rows of the trace per control period
TOLERANCE = 1e-4
JITTER = 0.1  # of a delay, from one packet to the next


def columns(car: SecondCar, n: int, sprung: float | None = None) -> SimpleNamespace:
  """The car's numbers repeated for n runs; `sprung`: mass the springs were made for [kg], the car's own if None."""
  table = {name: np.full(n, value) for name, value in car.described().items()}
  return SimpleNamespace(**table, warm=np.ones(n), sprung=np.full(n, sprung or car.mass))


class Simulation:
  """n runs. Public: chassis, state, trace (FINE * ticks + 1, 11, n) of SIGNALS, evaluations of the rates so far."""

  def __init__(
    self, car: SimpleNamespace, floor: Floor, start: np.ndarray, command: np.ndarray, ticks: int,
    rng: np.random.Generator, tolerance: float = TOLERANCE,
  ) -> None:  # fmt: skip
    """`start` (n, 7) as `Chassis.start` takes it; `command` (2, n) held for long enough before; `rng`: for packets."""
    self.car, self.chassis, self.tolerance = car, Chassis(car, floor), tolerance
    n = self.n = self.chassis.n
    array = self.chassis.start(start)
    State(array).reference[:] = command[0]
    self._y, self._scale = array.ravel(), np.repeat(list(SCALES.values()), n)
    self.commands, self.tick, self.evaluations = np.tile(command, (ticks + 1, 1, 1)), 0, 0
    stamps = PERIOD * np.arange(ticks)
    late = 1.0 + JITTER * rng.uniform(-1.0, 1.0, (2, ticks))
    delay = np.array([[car.drive_delay[0]], [car.steering_delay[0]]])
    self._arrival = np.maximum.accumulate(stamps + delay * late, axis=1)
    self._step = 1e-4
    self.trace = np.empty((FINE * ticks + 1, len(SIGNALS), n))
    self._hold(0.0)
    self._keep(0, array)

  @property
  def state(self) -> State:
    """Views of the present state."""
    return State(self._y.reshape(len(NAMES), self.n))

  def advance(self, command: np.ndarray, draught: np.ndarray) -> None:
    """One control period: `command` (2, n) [V, rad] is sent at its beginning; `draught` (3, n) [N, N, N m] acts."""
    begin, end = PERIOD * self.tick, PERIOD * (self.tick + 1)
    self.commands[self.tick + 1] = command
    self.chassis.draught = draught
    inside = self._arrival[(self._arrival > begin + 1e-9) & (self._arrival < end - 1e-9)]
    edges = np.unique(np.concatenate([[begin], inside, [end]]))
    for left, right in zip(edges[:-1], edges[1:], strict=True):
      if right - left > 1e-9:
        self._hold(left)
        self._integrate(left, right)
    self.tick += 1

  def _hold(self, time: float) -> None:
    """The commands that have arrived by now."""
    got = [int(np.searchsorted(row, time + 1e-9, side="right")) for row in self._arrival]
    drive, steer = (min(index, self.tick + 1) for index in got)
    self.chassis.command[0], self.chassis.command[1] = self.commands[drive, 0], self.commands[steer, 1]

  def _rates(self, _time: float, y: np.ndarray) -> np.ndarray:
    self.evaluations += 1
    return self.chassis.rates(y.reshape(len(NAMES), self.n)).ravel()

  def _integrate(self, begin: float, end: float) -> None:
    """From begin to end, filling the rows of the trace on the way. Raises RuntimeError where the step vanishes."""
    solver = RK23(
      self._rates, begin, self._y, end, first_step=min(self._step, end - begin), rtol=0.1 * self.tolerance,
      atol=self.tolerance * self._scale,  # pyright: ignore[reportArgumentType]  # an array is taken as well
    )  # fmt: skip
    row = int(np.floor(begin / PERIOD * FINE + 1e-6)) + 1
    while solver.status == "running":
      said = solver.step()
      if solver.status == "failed":
        raise RuntimeError(f"the second car's integrator gave up at {solver.t:.4f} s: {said}")
      if solver.t < end:
        self._step = max(1e-6, float(solver.h_abs))
      between = solver.dense_output()
      while row * PERIOD / FINE <= solver.t + 1e-9:
        self._keep(row, between(row * PERIOD / FINE).reshape(len(NAMES), self.n))
        row += 1
    self._y = solver.y

  def _keep(self, row: int, array: np.ndarray) -> None:
    """A row of the trace: the truth at this instant, accelerations as the IMU feels them where it sits."""
    if row >= len(self.trace):
      return
    self.chassis.rates(array)
    s, car, felt, spin = State(array), self.car, self.chassis.specific_force, self.chassis.spin_up
    x, y = car.imu_x, car.imu_y
    a_x = felt[0] - spin[2] * y + s.p * s.q * y - (s.q**2 + s.r**2) * x
    a_y = felt[1] + spin[2] * x + s.p * s.q * x - (s.p**2 + s.r**2) * y
    self.trace[row] = np.stack([
      s.x, s.y, s.yaw, s.u, s.v, s.r, a_x, a_y, s.motor, s.motor_angle, mean_angle(car, s.linkage)
    ])  # fmt: skip


def energy(simulation: Simulation) -> np.ndarray:
  """Energy of motion, of height and in springs, shafts and bristles (n,) [J], above the car at rest on a flat floor."""
  s, chassis, car = simulation.state, simulation.chassis, simulation.car
  moving = car.mass * (s.u**2 + s.v**2 + s.w**2) + sum(
    i * w**2 for i, w in zip(chassis.inertia, (s.p, s.q, s.r), strict=True)
  )
  turning = (car.wheel_inertia * s.wheel**2).sum(axis=0) + car.motor_inertia * s.motor**2
  lift = -np.sin(s.pitch) * chassis.corner_x + np.cos(s.pitch) * np.sin(s.roll) * chassis.corner_y
  pressed = car.cg_height - s.z - lift
  struts = (chassis.spring * pressed**2 + 2.0 * chassis.rest * pressed).sum(axis=0)
  wound = car.shaft_stiffness * s.twist**2 + car.gear_friction / car.gear_presliding * s.rub**2
  bent = (chassis.rest * (chassis.stiffness * s.bristle**2).sum(axis=0)).sum(axis=0)
  height = 2.0 * car.mass * GRAVITY * (s.z - car.cg_height)
  return 0.5 * (moving + turning + struts + wound + bent + height + car.motor_inductance * s.current**2)


__all__ = ["FINE", "NOMINAL_PACK", "SIGNALS", "Simulation", "columns", "energy"]
