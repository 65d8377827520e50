"""What the multi-body car's parameters conceal, and which of its numbers an explanation of a log may move.

Both axles have the same tyres in the package, so that a change of one axle's is none of its parameters. It has no
battery. Effects of its steering, its driveline's friction and its drag act on the wrapper's numbers.
"""

from __future__ import annotations

from typing import Any

from ..changes import add, divide, move, scale
from ..effects import Effect, Nuisance
from .numbers import TENTH, Numbers, Size

_BEHIND = 0.5  # of the rear half of the wheelbase: where a payload lies
_MASSES = ("car.m", "car.m_s", "car.m_uf", "car.m_ur")
_SPRINGS = ("car.K_sf", "car.K_sr", "car.K_tsf", "car.K_tsr")
_GRIP = ("car.tire.p_dx1", "car.tire.p_dy1")


def _payload(p: Numbers, size: float, later: bool) -> None:
  """A mass [kg] in the boot, at the height of the centre of gravity: by Steiner's theorem."""
  car = p.car
  behind = _BEHIND * car.b
  shift = size * behind / (car.m + size)
  more = car.m * shift**2 + size * (behind - shift) ** 2
  car.I_z, car.I_y_s = car.I_z + more, car.I_y_s + more
  car.m, car.m_s, car.a, car.b = car.m + size, car.m_s + size, car.a + shift, car.b - shift


def _front_share(name: str):
  """Share of a torque that goes to the front axle."""

  def act(p: Numbers, size: float, later: bool) -> None:
    setattr(p.car, name, size)

  return act


def _roll_balance(p: Numbers, size: float, later: bool) -> None:
  """Share of each front spring's and bar's stiffness that is taken to the rear."""
  for front, rear in (("K_sf", "K_sr"), ("K_tsf", "K_tsr")):
    moved = size * getattr(p.car, front)
    setattr(p.car, front, getattr(p.car, front) - moved)
    setattr(p.car, rear, getattr(p.car, rear) + moved)


def effects_of_size(size: Size) -> dict[str, Effect]:
  """The table for a car of this size: largest sizes in kg and kg/m go with it."""
  heavier = size.mass / TENTH.mass
  return {
    "servo_slow": Effect(
      "steering", "parameter", ("steering_lag",), "-", 20.0, scale("servo"), figures=("servo_time_constant",)
    ),
    "servo_slew": Effect(
      "steering", "parameter", ("steering_rate_limit",), "-", 100.0,
      divide("car.steering.v_max", "car.steering.v_min"),
    ),
    "steering_travel": Effect(
      "steering", "parameter", ("steering_saturation",), "-", 20.0, divide("car.steering.max", "car.steering.min")
    ),
    "drag": Effect(
      "drive", "parameter", ("quadratic_drag", "resistance_curve"), "kg/m", 4.0 * heavier / size.length, add("drag")
    ),
    "wheel_size": Effect("drive", "parameter", ("wheel_radius_error",), "-", 0.3, scale("car.R_w"), signed=True),
    "cg_height": Effect(
      "body", "parameter", ("load_transfer",), "-", 1.0, scale("car.h_s", "car.h_cg"), figures=("cg_height_offset",)
    ),
    "payload": Effect("body", "parameter", ("payload",), "kg", 2.0 * heavier, _payload, figures=("mass",)),
    "grip_later": Effect("ground", "parameter", ("friction_change",), "-", 4.0, divide(*_GRIP, late=True)),
    # outside the catalogue
    "brakes_in_front": Effect("drive", "parameter", (), "-", 1.0, _front_share("T_sb")),
    "drive_in_front": Effect("drive", "parameter", (), "-", 1.0, _front_share("T_se")),
    "roll_balance": Effect("body", "parameter", (), "-", 0.8, _roll_balance),
    "soft_mounts": Effect("body", "parameter", (), "-", 100.0, divide("car.K_ras", "car.K_rad")),
    "resistance_later": Effect(
      "drive", "parameter", ("resistance_change",), "-", 10.0, scale("dry", late=True)
    ),
  }  # fmt: skip


def nuisances_of(std: dict[str, float], n: Numbers) -> dict[str, Nuisance]:
  """What may be moved; `std` of what the owner states, in its unit, of a car of these numbers."""
  p: Any = n.car
  share = lambda name, value: std[name] / value
  return {
    "mass": Nuisance(scale(*_MASSES), 0.01, share("mass", p.m)),
    "yaw inertia": Nuisance(scale("car.I_z"), 0.02, share("yaw_inertia", p.I_z)),
    "centre of gravity": Nuisance(move("car.a", "car.b"), 0.01 * p.a, std["cg_to_front"]),
    "height": Nuisance(scale("car.h_s"), 0.05, share("cg_height", n.height)),
    "wheel radius": Nuisance(scale("car.R_w"), 0.005, share("wheel_radius", p.R_w)),
    "wheel inertia": Nuisance(scale("car.I_y_w"), 0.1),
    "torque": Nuisance(scale("per_ampere"), 0.01),
    "dry friction": Nuisance(scale("dry"), 0.02),
    "viscous friction": Nuisance(scale("fading"), 0.05),
    "slip stiffness": Nuisance(scale("car.tire.p_kx1"), 0.05),
    "side stiffness": Nuisance(scale("car.tire.p_ky1"), 0.03),
    "grip": Nuisance(scale(*_GRIP), 0.02),
    "shape": Nuisance(scale("car.tire.p_cy1"), 0.02),
    "springs": Nuisance(scale(*_SPRINGS), 0.05, 2.0 * share("suspension_frequency", n.bounce[0])),
    "dampers": Nuisance(scale("car.K_sdf", "car.K_sdr"), 0.05, share("suspension_damping_ratio", n.bounce[1])),
    "servo": Nuisance(scale("servo"), 0.03, std.get("servo_time_constant", float("inf")) / n.servo),
  }
