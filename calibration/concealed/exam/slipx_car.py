"""A car of slipx (Apache-2.0): 13-state double track, MF-lite tyres, relaxation, servo, speed controller, battery.

Numbers are the package's own reference car's, each drawn about it. The motor's current is a torque at the wheels, which
slipx takes as the acceleration that it would give the bare mass: a = I k / (m R_w), k its `torque_per_amp`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..laboratory.designs import plan
from ..laboratory.driver import Driver
from ..laboratory.manoeuvres import PERIOD, Manoeuvre
from .effects import Concealed, Nuisance, altered
from .generator import FINE, Start, load_package
from .owner import reading, readings
from .sensing import NOISE
from .slipx_effects import SLIPX_EFFECTS, slipx_nuisances

GEAR = 0.1  # wheel speed / motor speed, not in slipx, which states its motor at the wheels
SPREAD = {
  "mass": 0.12, "izz": 0.12, "h_cog": 0.2, "wheel_radius": 0.04, "c_kappa": 0.15, "roll_resist": 0.2,
  "drag_coeff": 0.2, "steer_bandwidth": 0.15,
}  # fmt: skip
"""Largest relative departure from the reference car, uniform."""
SPEED_FLOOR = 0.05  # m/s, of slipx's slip angles (`v_eps`, "numerical, not physical"); its own 0.5 lets a slow car turn
# 1.3 times as sharply as its front wheels point, and fades its rolling resistance
TORQUE_PER_AMP = (0.020, 0.030)  # N m/A at the wheels: the laboratory's currents of 6 to 12 A then give 1 to 2 m/s^2
ANSWER = 3.0  # 1/s, of the driver's feedback on speed
SERVO_STD = 0.0015  # s, of a lag that was filmed


class SlipxCar:
  """One drawn car; attributes of `Generator`."""

  design, drive_limit, drive_step, channel = "vesc_current", 40.0, 1e-2, "motor_current"
  noise: Mapping[str, float] = NOISE
  driver = Driver
  effects = SLIPX_EFFECTS

  def __init__(self, rng: np.random.Generator) -> None:
    """Raises MissingGenerator where slipx is not installed."""
    self.slipx = load_package("slipx", "slipx")
    self.params = drawn(self.slipx, rng)

  def runs(self, rng: np.random.Generator) -> list[Manoeuvre]:
    """The laboratory's design for a current."""
    return plan(self.design, rng)

  def plant(
    self, concealed: Sequence[Concealed] = (), moved: Sequence[tuple[Nuisance, float]] = (), later: bool = False
  ) -> SlipxPlant:
    """A fresh car with a full battery; the `Generator`'s arguments."""
    params = altered(copied(self.slipx, self.params), concealed, moved, later)
    fault = params.validate()
    if fault is not None:
      raise ValueError(f"no such car of slipx: {fault}")
    return SlipxPlant(self.slipx, params)

  def bench(self, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """The servo's lag at low frequencies, read off road wheels filmed at some hundred frames a second."""
    true = 2.0 * self.params.steer_damping / self.params.steer_bandwidth
    return {"servo_time_constant": reading(true, SERVO_STD, rng)}, {"servo_time_constant": SERVO_STD}

  def nuisances(self, std: Mapping[str, float]) -> dict[str, Nuisance]:
    """Numbers of slipx that a recalibration may move."""
    return slipx_nuisances(dict(std), self.params)

  def measured(self, rng: np.random.Generator) -> tuple[dict[str, float | str], dict[str, float]]:
    """As read off a scale, a ruler and a data sheet; the wheelbase itself is exact."""
    p = self.params
    true = {
      "mass": p.mass, "yaw_inertia": p.izz, "cg_to_front": p.lf, "cg_to_rear": p.lr, "track_width": p.track_rear,
      "cg_height": p.h_cog, "wheel_radius": p.wheel_radius, "motor_constant": p.torque_per_amp * GEAR,
    }  # fmt: skip
    read, std = readings(true, rng)
    known = {
      "layout": "rear",
      "differential": "open",
      "drive": "current",
      "gear_ratio": GEAR,
      "max_steering": p.steer_max,
    }
    return read | known | {"supply_voltage": p.pack_nominal_v, "max_current": p.current_max}, std

  def drive_line(self) -> tuple[float, float, float]:
    """Currents [A] from the resistances and the mass: a torque holds no speed, so none goes with speed."""
    p = self.params
    per_acceleration = p.mass * p.wheel_radius / p.torque_per_amp
    return 0.0, p.roll_resist * 9.81 * per_acceleration, ANSWER * per_acceleration

  def described(self) -> dict[str, float | str]:
    """The parameters by slipx's names."""
    return {"generator": "slipx", "version": str(self.slipx.__version__)} | numbers(self.params)


def drawn(slipx: Any, rng: np.random.Generator) -> Any:
  """Parameters about the reference car's: open differential, the tyres' stiffness and grip drawn together."""
  p = slipx.load_reference_car().params
  for name, spread in SPREAD.items():
    setattr(p, name, getattr(p, name) * rng.uniform(1.0 - spread, 1.0 + spread))
  base = p.lf + p.lr
  p.lf = base * rng.uniform(0.47, 0.53)
  p.lr = base - p.lf
  p.torque_per_amp = rng.uniform(*TORQUE_PER_AMP)
  p.v_eps = SPEED_FLOOR
  p.differential = slipx.Differential.Open
  stiff, grip = rng.uniform(0.85, 1.15), rng.uniform(0.85, 1.1)
  p.c_alpha_f, p.c_alpha_r = p.c_alpha_f * stiff, p.c_alpha_r * stiff * rng.uniform(1.0, 1.2)
  for tyre in (p.tyre_front, p.tyre_rear):
    tyre.mu_y0, tyre.mu_x0 = tyre.mu_y0 * grip, tyre.mu_x0 * grip
  p.validate()
  return p


def copied(slipx: Any, params: Any) -> Any:
  """Other parameters of the same values."""
  out = slipx.VehicleParams()
  for name in (n for n in dir(params) if not n.startswith("_")):
    value = getattr(params, name)
    if name.startswith("tyre_"):
      for inner in (n for n in dir(value) if not n.startswith("_")):
        setattr(getattr(out, name), inner, getattr(value, inner))
    elif not callable(value) and name != "wheelbase":  # lf + lr
      setattr(out, name, value)
  return out


def numbers(params: Any) -> dict[str, float | str]:
  """Every number and choice of slipx's parameters, tyres' as tyre_front.mu_y0."""
  out: dict[str, float | str] = {}
  for name in sorted(n for n in dir(params) if not n.startswith("_")):
    value = getattr(params, name)
    if callable(value):
      continue
    if name.startswith("tyre_"):
      out |= {f"{name}.{inner}": number for inner, number in numbers(value).items()}
    else:
      out[name] = float(value) if isinstance(value, (int, float)) else str(value)
  return out


class SlipxPlant:
  """One run, integrated by slipx itself (RK4) at 1 ms."""

  def __init__(self, slipx: Any, params: Any) -> None:
    self.slipx, self.params = slipx, params
    self.model = slipx.VehicleModel.create(slipx.Tier.L2_DoubleTrack, params)
    self.state, self.seen = slipx.VehicleState(), slipx.StepDiagnostics()
    self.per_ampere = params.torque_per_amp / (params.mass * params.wheel_radius)

  def start(self, start: Start) -> np.ndarray:
    """Rolling straight; wheels turn with the ground."""
    s = self.state
    s.pos.x, s.pos.y, s.yaw, s.vel_body.x = start.x, start.y, start.yaw, start.speed
    first = self._signals()
    first[8] = start.speed / (self.params.wheel_radius * GEAR)
    return first

  def advance(self, drive: float, steer: float) -> np.ndarray:
    """`drive`: motor current [A]."""
    command = self.slipx.DriveInput(steer_cmd=steer, accel_cmd=drive * self.per_ampere)
    rows = []
    for _ in range(FINE):
      self.model.step(self.state, command, PERIOD / FINE, self.seen)
      rows.append(self._signals())
    return np.array(rows)

  def _signals(self) -> np.ndarray:
    s, wheels = self.state, self.state.omega_w
    motor = 0.5 * (wheels[2] + wheels[3]) / GEAR
    return np.array([
      s.pos.x, s.pos.y, s.yaw, s.vel_body.x, s.vel_body.y, s.yaw_rate, self.seen.ax, self.seen.ay, motor, s.steer
    ])  # fmt: skip
