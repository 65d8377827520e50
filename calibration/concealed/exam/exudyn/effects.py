"""What the rigid-body car's numbers conceal, and which of them an explanation of a log may move.

Stiffness of the tyres, which are none, is taken as the sliding speed at which friction is full: of each axle, as a fit
of each axle's stiffness would move it.
"""

from __future__ import annotations

from ..changes import add, divide, move, scale
from ..effects import Effect, Nuisance
from .numbers import Numbers

_BEHIND = 0.5  # of the rear half of the wheelbase: where a payload lies
_INERTIAS = ("roll_inertia", "pitch_inertia", "yaw_inertia")
_GRIP = ("grip_left", "grip_right")


def _payload(p: Numbers, size: float, later: bool) -> None:
  """A mass [kg] on the rear deck, at the height of the chassis' centre; inertias by Steiner's theorem."""
  mass, place = p.chassis
  away = -_BEHIND * p.behind
  more = mass * size / (mass + size) * (away - float(place[0])) ** 2
  p.pitch_inertia, p.yaw_inertia = p.pitch_inertia + more, p.yaw_inertia + more
  shift = -size * away / (p.mass + size)
  p.height += size * float(place[2]) / (p.mass + size)
  p.mass, p.ahead, p.behind = p.mass + size, p.ahead + shift, p.behind - shift


EXUDYN_EFFECTS: dict[str, Effect] = {
  "servo_slow": Effect(
    "steering", "parameter", ("steering_lag",), "-", 12.0, scale("servo"), figures=("servo_time_constant",)
  ),
  "servo_slew": Effect("steering", "parameter", ("steering_rate_limit",), "-", 100.0, divide("servo_rate")),
  "steering_travel": Effect("steering", "parameter", ("steering_saturation",), "-", 10.0, divide("travel")),
  "drag": Effect("drive", "parameter", ("quadratic_drag", "resistance_curve"), "kg/m", 4.0, add("drag")),
  "limited_slip": Effect("drive", "parameter", ("differential_lock",), "N m", 0.3, add("preload")),
  "wheel_size": Effect("drive", "parameter", ("wheel_radius_error",), "-", 0.3, scale("radius"), signed=True),
  "resistance_later": Effect("drive", "parameter", ("resistance_change",), "-", 10.0, scale("dry", late=True)),
  "cg_height": Effect(
    "body", "parameter", ("load_transfer",), "-", 1.5, scale("height"), figures=("cg_height_offset",)
  ),
  "payload": Effect("body", "parameter", ("payload",), "kg", 6.0, _payload, figures=("mass",)),
  "grip_later": Effect("ground", "parameter", ("friction_change",), "-", 4.0, divide(*_GRIP, late=True)),
  # outside the catalogue
  "dragging_wheel": Effect("drive", "parameter", (), "N m", 0.5, add("dragging")),
  "drive_of_one_side": Effect("drive", "parameter", (), "-", 0.5, add("left_share"), signed=True),
  "bent_axle": Effect("body", "parameter", (), "rad", 0.2, add("bent"), signed=True),
  "toe": Effect("steering", "parameter", (), "rad", 0.2, add("toe"), signed=True),
  "grip_left": Effect("tyre", "parameter", (), "-", 4.0, divide("grip_left")),
}


def exudyn_nuisances(std: dict[str, float], n: Numbers) -> dict[str, Nuisance]:
  """What may be moved; `std` of what the owner states, in its unit, of a car of these numbers."""
  share = lambda name, value: std[name] / value
  return {
    "mass": Nuisance(scale("mass"), 0.01, share("mass", n.mass)),
    "yaw inertia": Nuisance(scale(*_INERTIAS), 0.02, share("yaw_inertia", n.yaw_inertia)),
    "centre of gravity": Nuisance(move("ahead", "behind"), 0.002, std["cg_to_front"]),
    "height": Nuisance(scale("height"), 0.05, share("cg_height", n.height)),
    "wheel radius": Nuisance(scale("radius"), 0.005, share("wheel_radius", n.radius)),
    "wheel inertia": Nuisance(scale("wheel_spin"), 0.1),
    "torque": Nuisance(scale("per_ampere"), 0.01),
    "dry friction": Nuisance(scale("dry"), 0.02),
    "viscous friction": Nuisance(scale("fading"), 0.05),
    "front stiffness": Nuisance(divide("zone_front"), 0.03),
    "rear stiffness": Nuisance(divide("zone_rear"), 0.03),
    "grip": Nuisance(scale(*_GRIP), 0.02),
    "springs": Nuisance(scale("stiffness"), 0.05, 2.0 * share("suspension_frequency", n.bounce[0])),
    "dampers": Nuisance(scale("damping"), 0.05, share("suspension_damping_ratio", n.bounce[1])),
    "servo": Nuisance(scale("servo"), 0.03, std.get("servo_time_constant", float("inf")) / n.servo),
    "servo damping": Nuisance(scale("servo_damping"), 0.03),
  }
