"""Differentials that hold left and right wheels together."""

from collections.abc import Mapping

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.twin.mechanisms.base import Array, CarDimensions, Context, Mechanism, Model
from qcar_twin.twin.mechanisms.elements import EITHER
from qcar_twin.vehicle.mjcf import locked_damping

HALF_LOCK = 0.02  # N m s/rad: damping at which a tight slow turn is half-way to a locked axle
LOCKED = locked_damping() / (locked_damping() + HALF_LOCK)  # degree from which on an axle is locked, 0.98
# stated prior: degree of locking by 5e-3 N m s/rad, silicone oil of 25 Pa s between 6 cm^2 of gears and housing, 0.3 mm
# apart, at 1 cm
_OIL = 0.2
_CLAMPED = 0.012  # N m, stated prior: 100 N that hold a ball differential together, 1 % rolling friction, at 12 mm


class DifferentialLock(Mechanism):
  """Left and right wheels of an axle resist turning at different speeds.

  Equation: M_wheel = -d (omega - omega_other side) - T sgn(omega - omega_other side) on each axle,
  d = 0.02 x / (1 - x) N m s/rad.
  Units: x -, 0 an open differential, 1 a locked axle; d N m s/rad; T N m, a preload that holds the wheels together
  until it is overcome. In a turn it gives a yaw moment against the yaw rate, which the tyres limit to one that goes
  with -r / v; that of a preload does not depend on speed.
  Source: Wong, Theory of Ground Vehicles, 4th ed., 2008, ch. 3; Genta and Morello, The Automotive Chassis, 2009.
  Size: stated prior: 0.4 is nearly half-way to a locked axle; 0.02 N m is a ninth of what a wheel's friction holds,
    0.8 x 6.6 N x 0.033 m.
  Confounded with: steering_drag, tyre scrub, steering_gain_error at one speed.
  """

  name = "differential_lock"
  subsystem = "drive"
  stage = "contact"
  dissipative = True
  fitted_rank = 21
  whole = ("differential_lock",)
  parameters = (
    Parameter("differential_lock", 0.0, 0.0, 1.0, "-", "x", null=0.0, typical=0.4, description="degree of locking"),
    Parameter("differential_preload", 0.0, 0.0, 0.5, "N m", "T", null=0.0, typical=0.02, description="constant torque"),
  )

  def tolerances(self, car: CarDimensions, std: Mapping[str, float]) -> Mapping[str, float]:
    """Open differentials run in grease or in oil, and some are clamped: what a full housing of a stiff one holds, and
    what a tight clamp does, is three deviations. Whether an axle is locked, few descriptions of cars with one driven
    axle say: the recordings tell."""
    degree = {"open": _OIL / 3.0, "unknown": EITHER}.get(car.differential, 0.0)
    return {"differential_lock": degree, "differential_preload": _CLAMPED / 3.0 if degree else 0.0}

  def write_model(self, theta: Array, context: Context, model: Model) -> None:
    degree = np.minimum(theta[:, 0], LOCKED)
    model.set("differential_damping", model.get("differential_damping") + HALF_LOCK * degree / (1.0 - degree))
    model.set("differential_friction", model.get("differential_friction") + theta[:, 1])
