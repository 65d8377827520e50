"""What a car's motor takes as its command, and which axles it turns.

Whatever the command u, the motor's law is linear in it and in the motor's speed, within what the electronics allow:
  torque = clip(a u - b omega, -T_max, T_max); the driveline's friction comes on top.
voltage, u in V: a = K/R, b = K^2/R + B (armature circuit without inductance; Krishnan, Electric Motor Drives, 2001,
  ch. 2). duty, u from -1 to 1: the same with u times the supply's voltage.
current, u in A: a = K, b = B: the electronics keep the current, and the back-EMF does not show.
acceleration, u in m/s^2: a = J / (G R_w), b = B, J all that turns and moves: electronics or a simulator that give the
  force a wished acceleration takes.
speed, u in m/s: a = k / (G R_w), b = k + B: a speed loop of gain k (Franklin, Powell and Emami-Naeini, Feedback
  Control of Dynamic Systems, 7th ed., 2015, sec. 4.3). Its integral part, which takes over the friction, comes on top:
  qcar_twin/twin/mechanisms/speed_loop_integral.py.
"""

import dataclasses
import math
from typing import Literal

Layout = Literal["all-wheel", "rear", "front"]
DriveKind = Literal["voltage", "duty", "current", "speed", "acceleration"]
MOTOR_FIGURES = ("motor_constant", "motor_resistance", "max_current")  # of a data sheet or bench
DIFFERENTIALS = ("open", "locked", "unknown")
"""How the wheels of a driven axle hold together: hardly, rigidly, or as the recordings show."""
DRIVEN_AXLES: dict[str, tuple[str, ...]] = {"all-wheel": ("front", "rear"), "rear": ("rear",), "front": ("front",)}
FRONT_SHARE: dict[str, float] = {"all-wheel": 0.5, "rear": 0.0, "front": 1.0}
"""By layout, of the front wheels in what the encoder on the motor sees."""


@dataclasses.dataclass(frozen=True)
class Drive:
  """One kind of drive command.

  Attributes:
    channel: of a recording that holds the command.  unit: of the command.
    gain: the vehicle's number and the twin's parameter that is torque per command, a.  gain_unit, gain_symbol: of it.
    damping_symbol: b in letters.
    usual: P1 [rad/s^2 per unit] and P2 [1/s] of a usual 1:10 car's bicycle.
    steps: manoeuvre of its steps, which identify the drive; "" where the speed settles under no constant command.
  """

  channel: str
  unit: str
  gain: str
  gain_unit: str
  gain_symbol: str
  damping_symbol: str
  usual: tuple[float, float]
  steps: str = ""


_FULL_OVER_EMPTY = 4.2 / 3.0  # V of a lithium cell, charged and at its cut-off: what a supply that is stated may be off
_ARMATURE = ("torque_per_volt", "N m/V", "K_t/R_a", "K_t K_v/R_a + B")
DRIVES: dict[str, Drive] = {
  "voltage": Drive("motor_voltage", "V", *_ARMATURE, (850.0, 2.5), "voltage_step"),
  "duty": Drive("motor_duty", "-", *_ARMATURE, (1e4, 2.5), "duty_step"),
  "current": Drive("motor_current", "A", "torque_per_ampere", "N m/A", "K_t", "B", (80.0, 0.15)),
  "speed": Drive(
    "speed_command", "m/s", "torque_per_speed", "N m s/m", "k/(G R_w)", "k + B", (3e3, 10.0), "speed_step"
  ),
  "acceleration": Drive(
    "acceleration_command", "m/s^2", "torque_per_acceleration", "N m s^2/m", "J/(G R_w)", "B", (300.0, 0.15)
  ),
}


def largest_command(drive: DriveKind, supply: float) -> float:
  """What a scaled command is limited to: the supply's V, for a duty a full battery's; others are not."""
  if drive not in ("voltage", "duty"):
    return math.inf
  return supply * (_FULL_OVER_EMPTY if drive == "duty" else 1.0)


def motor_figures(
  given: dict[str, float | str], std: dict[str, float], drive: str
) -> tuple[dict[str, float | str], dict[str, float]]:
  """K, R and the largest current of a data sheet or bench as the drive's numbers, with their standard deviations.

  The damping's is widened by 15 %: the bench does not see bearings and gears.
  """
  given = dict(given)
  constant, resistance, current = (given.pop(name, None) for name in MOTOR_FIGURES)
  if constant is not None and current is not None:
    given.setdefault("max_torque", float(constant) * float(current))
  if drive == "current" and constant is not None:
    given.setdefault("torque_per_ampere", float(constant))
    std.setdefault("torque_per_ampere", std.pop("motor_constant", 0.05 * float(constant)))
  if drive not in ("voltage", "duty"):
    return given, std
  if constant is None or resistance is None:
    return given, std
  k, r = float(constant), float(resistance)
  share_k, share_r = std.pop("motor_constant", 0.05 * k) / k, std.pop("motor_resistance", 0.1 * r) / r
  given.setdefault("torque_per_volt", k / r)
  given.setdefault("motor_damping", k**2 / r)
  std.setdefault("torque_per_volt", k / r * math.hypot(share_k, share_r))
  std.setdefault("motor_damping", k**2 / r * math.hypot(2.0 * share_k, share_r, 0.15))
  return given, std
