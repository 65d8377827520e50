"""What slipx's own parameters conceal, and which of its numbers an explanation of a log without an effect may move.

A current is a torque at the wheels, far below what battery and speed controller can give: pack resistance, charge and
efficiency have no reach here. A spool is a limited slip of much preload. Rolling resistance, slip stiffness, servo
damping, relaxation and tyre shape of both axles are what a recalibration fits: a change of one alone is no effect.
"""

from __future__ import annotations

from typing import Any

from .changes import add, divide, move, scale
from .effects import Effect, Nuisance

_MOST_BEHIND = 0.5  # of the rear half of the wheelbase: where a payload lies


def _payload(p: Any, size: float, later: bool) -> None:
  """A mass [kg] on the rear deck: centre of gravity and yaw inertia by Steiner's theorem."""
  behind = _MOST_BEHIND * p.lr
  shift = size * behind / (p.mass + size)
  p.izz += p.mass * shift**2 + size * (behind - shift) ** 2
  p.mass, p.lf, p.lr = p.mass + size, p.lf + shift, p.lr - shift


def _preload(p: Any, size: float, later: bool) -> None:
  p.differential, p.lsd_preload = type(p.differential).Lsd, size


_FRONT, _REAR = ("tyre_front.mu_y0", "tyre_front.mu_x0"), ("tyre_rear.mu_y0", "tyre_rear.mu_x0")

SLIPX_EFFECTS: dict[str, Effect] = {
  "servo_bandwidth": Effect(
    "steering", "parameter", ("steering_lag",), "-", 20.0, divide("steer_bandwidth"), figures=("servo_time_constant",)
  ),
  "servo_slew": Effect("steering", "parameter", ("steering_rate_limit",), "-", 100.0, divide("steer_rate_max")),
  "steering_travel": Effect("steering", "parameter", ("steering_saturation",), "-", 2.0, divide("steer_max")),
  "drag": Effect("drive", "parameter", ("quadratic_drag", "resistance_curve"), "kg/m", 4.0, add("drag_coeff")),
  "limited_slip": Effect("drive", "parameter", ("differential_lock",), "N m", 1.0, _preload),
  "brake_limit": Effect(
    "drive", "parameter", ("drive_limit", "drive_asymmetry"), "-", 400.0, divide("regen_current_max")
  ),
  "current_limit": Effect("drive", "parameter", ("drive_limit",), "-", 100.0, divide("current_max")),
  "wheel_size": Effect("drive", "parameter", ("wheel_radius_error",), "-", 0.3, scale("wheel_radius"), signed=True),
  # beside the 0.15 of its tyres: from an exponent of 1 on, a tyre would hold less the more it carries
  "load_sensitivity": Effect(
    "tyre", "parameter", ("load_transfer",), "-", 0.8, add("tyre_front.k_mu", "tyre_rear.k_mu")
  ),
  "cg_height": Effect("body", "parameter", ("load_transfer",), "-", 2.0, scale("h_cog"), figures=("cg_height_offset",)),
  "relaxation_front": Effect("tyre", "parameter", ("tyre_relaxation",), "-", 30.0, scale("tyre_front.relax_length")),
  "payload": Effect("body", "parameter", ("payload",), "kg", 4.0, _payload, figures=("mass",)),
  "grip_later": Effect("ground", "parameter", ("friction_change",), "-", 4.0, divide(*_FRONT, *_REAR, late=True)),
  "resistance_later": Effect("drive", "parameter", ("resistance_change",), "-", 10.0, scale("roll_resist", late=True)),
  # outside the catalogue
  "grip_front": Effect("tyre", "parameter", (), "-", 4.0, divide(*_FRONT)),
}


def slipx_nuisances(std: dict[str, float], params: Any) -> dict[str, Nuisance]:
  """What may be moved; `std` of what the owner states, in its unit, of a car of these parameters."""
  share = lambda name, value: std[name] / value
  slow = params.steer_bandwidth / (2.0 * params.steer_damping)  # 1/s: one over the servo's lag at low frequencies
  return {
    "mass": Nuisance(scale("mass"), 0.01, share("mass", params.mass)),
    "yaw inertia": Nuisance(scale("izz"), 0.02, share("yaw_inertia", params.izz)),
    "centre of gravity": Nuisance(move("lf", "lr"), 0.002, std["cg_to_front"]),
    "height": Nuisance(scale("h_cog"), 0.05, share("cg_height", params.h_cog)),
    "wheel radius": Nuisance(scale("wheel_radius"), 0.005, share("wheel_radius", params.wheel_radius)),
    "torque": Nuisance(scale("torque_per_amp"), 0.01),
    "rolling resistance": Nuisance(scale("roll_resist"), 0.02),
    "slip stiffness": Nuisance(scale("c_kappa"), 0.05),
    "front stiffness": Nuisance(scale("c_alpha_f"), 0.03),
    "rear stiffness": Nuisance(scale("c_alpha_r"), 0.03),
    "grip": Nuisance(scale(*_FRONT, *_REAR), 0.02),
    "shape": Nuisance(scale("tyre_front.shape_c", "tyre_rear.shape_c"), 0.02),
    "relaxation": Nuisance(scale("tyre_front.relax_length", "tyre_rear.relax_length"), 0.05),
    "servo": Nuisance(divide("steer_bandwidth"), 0.03, std.get("servo_time_constant", float("inf")) * slow),
    "servo damping": Nuisance(scale("steer_damping"), 0.03),
  }
