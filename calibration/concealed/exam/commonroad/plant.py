"""One run of the multi-body car: the package's right-hand side, integrated.

Its wheels are stiff (4000 1/s at 1 m/s at 1:10), its axles across half as much, and all else is not. So the method is
the two-stage Rosenbrock method of second order whose matrix may be any (Verwer et al., SIAM J. Sci. Comput. 20, 1999):
that of the four wheels alone, which spin up to what rolls, and of the two axles, which go aside with the body.

The package turns a wished acceleration into a torque m R_w u at the driven wheels, and takes a rate of steering. So a
current and the driveline's losses are a torque, and a position loop of first order turns the road wheels. Its axes are
SAE's, y to the right and z down, and with tyres that are the same to both sides its equations are the same in a mirror:
y, yaw and steering are read as to the left. The IMU sits on the sprung mass: it feels gravity by roll and pitch.
"""

from __future__ import annotations

from math import copysign, expm1, sin, sqrt

import numpy as np

from ...laboratory.manoeuvres import PERIOD
from ..generator import FINE, Start, load_package
from .numbers import GRAVITY, Numbers
from .rates import Rates

_GAMMA = 1.0 + 1.0 / sqrt(2.0)  # of the method: damps what is infinitely stiff
_STEEPER = 1.5  # slip stiffness in the method's matrix, over that of the static load: load moves to the outer wheel
_WHEELS = (23, 24, 25, 26)
_SLOWEST = 0.1  # m/s: below it the package's model is another one
_ENOUGH = 20  # steps to the spin of a rolling wheel, each of which leaves a third of what is missing


class CommonroadPlant:
  """A `Plant` of these numbers; gear: wheel speed / motor speed."""

  def __init__(self, numbers: Numbers, gear: float, steps: int) -> None:
    self.p, self.numbers, self.gear, self.steps = numbers.car, numbers, gear, steps
    self.rate = Rates()
    self.state: list[float] = []

  def start(self, start: Start) -> np.ndarray:
    """Rolling straight, at rest on springs and tyres (the package's own start is not), with wheels that slip as long as
    nothing drives: a recording begins in a drive that goes on."""
    p = self.p
    at_rest = load_package("vehiclemodels.init_mb", "commonroad-vehicle-models").init_mb
    self.state = x = [float(v) for v in at_rest([start.x, start.y, 0.0, start.speed, start.yaw, 0.0, 0.0], p)]
    x[8] = (x[21] - x[16]) / (p.a + p.b)  # springs as long as under the static load
    x[11] = x[16] + p.a * x[8]
    for _ in range(_ENOUGH):
      rate = self.rate(list(x), (0.0, self._push(0.0)), p)
      for wheel, (stiffness, _) in self._held().items():
        x[wheel] += (rate[wheel] - rate[3] / p.R_w) / stiffness
    return self._signals(self.rate(list(x), (0.0, self._push(0.0)), p))

  def advance(self, drive: float, steer: float) -> np.ndarray:
    """`drive`: motor current [A]. Raises ValueError where the car comes to a stand, or spins."""
    p, step = self.p, PERIOD / self.steps
    drive, steer = float(drive), float(steer)
    slowest = self.state[3] - 0.5 * max(p.T_f, p.T_r) * abs(self.state[5])  # of its wheels' centres
    if slowest < _SLOWEST:
      raise ValueError(
        f"the multi-body car has no model for wheels below {_SLOWEST:g} m/s; one is at {slowest:.2g} m/s"
      )
    goal, share = min(max(steer, p.steering.min), p.steering.max), -expm1(-step / self.numbers.servo) / step
    rows = []
    for _ in range(self.steps):
      command = (share * (goal - self.state[2]), self._push(drive))
      rate = self.rate(list(self.state), command, p)
      rows.append(self._signals(rate))
      self._step(rate, command, step)
    rows.append(self._signals(self.rate(list(self.state), command, p)))
    grid, known = np.arange(1, FINE + 1) * self.steps / FINE, np.arange(self.steps + 1)
    return np.stack([np.interp(grid, known, column) for column in np.array(rows).T], axis=1)

  def _step(self, rate: list[float], command: tuple[float, float], step: float) -> None:
    """y+ = y + (3 k1 + k2) h / 2, (1 - gamma h A) k1 = f(y), (1 - gamma h A) k2 = f(y + h k1) - 2 k1; `rate`: f(y)."""
    x = self.state
    first = self._solved(rate, step)
    moved = self.rate([v + step * k for v, k in zip(x, first, strict=True)], command, self.p)
    second = self._solved([f - 2.0 * k for f, k in zip(moved, first, strict=True)], step)
    self.state = [v + step * (1.5 * a + 0.5 * b) for v, a, b in zip(x, first, second, strict=True)]

  def _solved(self, right: list[float], step: float) -> list[float]:
    """k of (1 - gamma h A) k = right. A: d(spin) decays to what rolls at the speed of the wheel's centre, and an
    axle's side speed to the body's there."""
    p, out = self.p, list(right)
    for wheel, (stiffness, aside) in self._held().items():
      stiff = _GAMMA * step * stiffness
      rolling = (right[3] + aside * right[5]) / p.R_w
      out[wheel] = (right[wheel] + stiff * rolling) / (1.0 + stiff)
    across = _STEEPER * abs(p.tire.p_ky1) * 0.5 * p.m * GRAVITY / max(self.state[3], _SLOWEST)
    for axle, ahead, mass in ((15, p.a, p.m_uf), (20, -p.b, p.m_ur)):
      stiff = _GAMMA * step * across / mass
      out[axle] = (right[axle] + stiff * (right[10] + ahead * right[5])) / (1.0 + stiff)
    return out

  def _held(self) -> dict[int, tuple[float, float]]:
    """Of each wheel's spin how fast its tyre brings it to what rolls, 1/s, and how far it is to the side, m."""
    p, x = self.p, self.state
    grip = _STEEPER * p.R_w**2 * p.tire.p_kx1 * 0.25 * p.m * GRAVITY / p.I_y_w
    asides = (0.5 * p.T_f, -0.5 * p.T_f, 0.5 * p.T_r, -0.5 * p.T_r)
    return {w: (grip / max(x[3] + y * x[5], _SLOWEST), y) for w, y in zip(_WHEELS, asides, strict=True)}

  def _push(self, current: float) -> float:
    """The acceleration that the package turns into the torque at the driven wheels."""
    n, p, spin = self.numbers, self.p, 0.5 * (self.state[25] + self.state[26])
    lost = n.dry * copysign(1.0, spin) + n.fading * spin + n.drag * p.R_w**3 * spin * abs(spin)
    return (n.per_ampere * current - lost) / (p.m * p.R_w)

  def _signals(self, rate: list[float]) -> np.ndarray:
    x = self.state
    along = rate[3] - x[5] * x[10] + GRAVITY * sin(x[8])
    across = rate[10] + x[5] * x[3] - GRAVITY * sin(x[6])
    motor = 0.5 * (x[25] + x[26]) / self.gear
    return np.array([x[0], x[1], x[4], x[3], x[10], x[5], along, across, motor, x[2]])
