"""The generator's own benign differences from a textbook car; the tests' `ablation` says how much each does."""

from __future__ import annotations

from .car import Car

UNITS = {
  "transient slip of the carcass": ("relaxation", "m"),
  "Ackermann share": ("ackermann", "-"),
  "rolling resistance at the wheels": ("rolling_resistance", "-"),
  "body roll and pitch": ("roll_rate", "rad/s"),
  "share of the brush in the tyre law": ("brush_share", "-"),
  "tyre load curve": ("load_curve", "-"),
  "armature warms": ("copper", "1/K"),
  "pack voltage falls over the whole charge": ("discharge", "-"),
  "dry friction builds up over a motor angle": ("presliding", "rad"),
}
BUILT_IN = (
  "tyre law of hyperbolic tangent and brush",
  "encoder differenced over 4 ms",
  "IMU averaged over 2 ms",
  "coloured forces and uneven floor",
)


def gaps(car: Car) -> list[dict]:
  """Each gap with this car's own value, for the truth file."""
  valued = [{"gap": gap, "value": float(getattr(car, name)), "unit": unit} for gap, (name, unit) in UNITS.items()]
  servo = {"gap": "servo, equivalent delay", "value": 2 * car.servo_damping / car.servo_rate, "unit": "s"}
  return [*valued, servo, *({"gap": gap} for gap in BUILT_IN)]
