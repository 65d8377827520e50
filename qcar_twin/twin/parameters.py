"""The parameters the base twin has, with their priors, and the quantities they stand for.

Priors: what a person measures with a scale and a ruler carries the standard deviation stated with
the vehicle; motor, damping and cornering stiffness are open; what is hard to see in recordings
(friction peak, slip stiffness, transient slip, servo) is held near figures typical of the class.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.vehicle.tyre import law_parameters, tyre_laws
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
_LOSSES = ("motor_damping", "driveline_friction", "drive_damping", "drive_friction")
_LOOP_REACH = 6.0  # times slower or faster than usual; a loop yet faster chatters at steps of 5 ms when the wheels slip


def base_parameters(vehicle: Vehicle) -> ParameterSet:
  """The base twin's parameters for a car, nominal values and priors from its numbers."""
  v, std, motor, size = vehicle, vehicle.std, vehicle.motor, vehicle.similarity
  length = v.cg_to_front + v.cg_to_rear
  reach = _LOOP_REACH if v.drive == "speed" else 40.0
  return ParameterSet(
    (
      _open(motor.gain, v.torque_per_command, reach, motor.gain_unit, motor.gain_symbol, std.get(motor.gain)),
      _open("motor_damping", v.motor_damping, reach, "N m s/rad", motor.damping_symbol, std.get("motor_damping")),
      Parameter("driveline_friction", v.driveline_friction, 0.0, 40.0 * v.driveline_friction, "N m", "T_c",
                typical=0.3 * v.driveline_friction),
      # steps of the voltage show only its sum with the car's mass; one much lighter lets the wheels chatter when they
      # slip
      _near("rotor_inertia", v.rotor_inertia, 0.4, "kg m^2", "J_m", 3.0),
      _open("cornering_stiffness_front", v.cornering_stiffness_front, 8.0, "N/rad", "C_f"),
      _open("cornering_stiffness_rear", v.cornering_stiffness_rear, 8.0, "N/rad", "C_r"),
      _near("longitudinal_stiffness", v.longitudinal_stiffness, 0.15, "N", "C_x", 4.0),
      _near("friction_coefficient", v.friction_coefficient, 0.08, "-", "mu", 3.0),
      *(dataclasses.replace(p, nominal=getattr(v, p.name, p.nominal)) for p in law_parameters(v.tyre_law)),
      Parameter("relaxation_length", v.relaxation_length, 0.0, 0.15 * size.length, "m", "sigma",
                std=0.003 * size.length),
      # of the carcass and, in series with it, of shafts that twist by C_x R_w^2 / k: as long again, or a softer shaft's
      Parameter("longitudinal_relaxation_length", v.longitudinal_relaxation_length, 0.0, 0.15 * size.length, "m",
                "sigma_x", std=0.01 * size.length),
      Parameter("servo_time_constant", v.servo_time_constant, 0.001 * size.time, 0.2 * size.time, "s",
                "tau_s", std=std.get("servo_time_constant", 0.002 * size.time)),
      Parameter("ackermann_fraction", v.ackermann_fraction, -0.5, 1.6, "-", "f_A", std=0.3),
      _measured("mass", v.mass, std.get("mass", 0.02 * v.mass), "kg", "m"),
      _measured("yaw_inertia", v.yaw_inertia, std.get("yaw_inertia", 0.1 * v.yaw_inertia), "kg m^2", "I_G"),
      Parameter("cg_to_front", v.cg_to_front, 0.2 * length, 0.8 * length, "m", "L_f",
                std=std.get("cg_to_front", 0.01 * length)),
      Parameter("cg_height_offset", 0.0, -0.8 * v.cg_height, 1.5 * v.cg_height, "m", "dh",
                std=std.get("cg_height", 0.1 * v.cg_height)),
      Parameter("suspension_frequency", v.suspension_frequency, 0.25 * v.suspension_frequency, stiffest_suspension(v),
                "Hz", "f_z", std=0.5 * v.suspension_frequency),
      *_centre(v),
      *_torque_limit(v),
    )
  )  # fmt: skip


def _centre(vehicle: Vehicle) -> tuple[Parameter, ...]:
  """The differential between two driven axles: few descriptions of a car say whether there is one."""
  if len(vehicle.driven_axles) < 2:
    return ()
  name, std = "centre_differential", vehicle.std.get("centre_differential", 0.5)
  return (Parameter(name, vehicle.centre_differential, 0.0, 1.0, "-", "x_c", std=std),)


def _torque_limit(vehicle: Vehicle) -> tuple[Parameter, ...]:
  """The limit of the motor's torque, where it has one."""
  if not np.isfinite(vehicle.max_torque):
    return ()
  std = vehicle.std.get("max_torque")
  return (_open("max_torque", vehicle.max_torque, 8.0, "N m", "T_max", std),)


def drive_values(vehicle: Vehicle, gain: float, damping: float, friction: float) -> dict[str, float]:
  """The twin's drive parameters of a car with P1 [rad/s^2 per unit of the command], P2 [1/s] and P3 [rad/s^2]."""
  values = {vehicle.motor.gain: gain / vehicle.command_scale, "motor_damping": damping, "driveline_friction": friction}
  return {name: value * vehicle.drive_inertia for name, value in values.items()}


def drive_response(vehicle: Vehicle, base: ParameterSet) -> tuple[float, float, float]:
  """P1, P2 and P3 of the twin's drive parameters; `drive_values` the other way round."""
  names = (vehicle.motor.gain, "motor_damping", "driveline_friction")
  gain, damping, friction = (base[name].nominal / vehicle.drive_inertia for name in names)
  return gain * vehicle.command_scale, damping, friction


def stiffest_suspension(vehicle: Vehicle) -> float:
  """Bounce frequency up to which a wheel on its spring is stable at the longest steps, Hz: h^2 k / m of 2.2, where
  explicit Euler without damping stands 4. Half of what is left is for the damper (see mjcf.suspension_damping)."""
  sprung = vehicle.mass - 4.0 * vehicle.wheel_mass
  stable = np.sqrt(2.2 * 4.0 * vehicle.wheel_mass / sprung) / (2.0 * np.pi * vehicle.similarity.longest_step)
  return float(max(stable, 1.01 * vehicle.suspension_frequency))


def quantities(theta: Array, base: ParameterSet, vehicle: Vehicle) -> dict[str, Array]:
  """Simulator quantities of N cars from their parameters (N, P >= len(base)): (N,) or, per wheel, (N, 4)."""
  size = len(theta)
  column = {name: np.array(theta[:, i]) for i, name in enumerate(base.names)}
  wheelwise = lambda value: np.tile(np.asarray(value, float).reshape(-1, 1), (size // np.size(value), 4))
  front, rear = column.pop("cornering_stiffness_front") / 2, column.pop("cornering_stiffness_rear") / 2
  out = {
    "torque_per_volt": column.pop(vehicle.motor.gain),
    "cornering_stiffness": np.stack([front, front, rear, rear], axis=-1),
    "longitudinal_stiffness": wheelwise(column.pop("longitudinal_stiffness") / 4),
    "friction_coefficient": wheelwise(column.pop("friction_coefficient")),
    "relaxation_length": wheelwise(column.pop("relaxation_length")),
    "longitudinal_relaxation_length": wheelwise(column.pop("longitudinal_relaxation_length")),
    "load_exponent": wheelwise(vehicle.load_exponent),
    "suspension_damping_ratio": np.full(size, vehicle.suspension_damping_ratio),
  }
  # a law the car's tyres don't follow has its parameters all the same, so that what changes them finds them
  own = {p.name: column.pop(p.name, np.array(p.nominal)) for law in tyre_laws().values() for p in law}
  out |= {name: wheelwise(value) for name, value in own.items()}
  zeros = ("driveline_damping", "differential_damping", "differential_friction", "gravity_x", "gravity_y")
  zeros += ("added_mass", "added_mass_x", "added_mass_y", "cg_lateral_offset")
  return out | column | {name: np.zeros(size) for name in zeros}


def informed(parameters: ParameterSet, values: Mapping[str, float]) -> ParameterSet:
  """The same parameters with better first guesses: the nominal value and what goes by it move along.

  A first guess bounds nothing: bounds reach as far as those about the old value and those about the new one do
  together. Nor do steps shrink of a loss that is guessed to be next to nothing, where another effect may have hidden
  it. Only parameters without a measured prior are moved; a measured one keeps its value.
  """
  moved = {}
  for name, value in values.items():
    old = parameters[name]
    if old.std is not None or not np.isfinite(value) or value <= 0 or old.nominal <= 0:
      continue
    ratio = value / old.nominal
    lower, upper = min(old.lower, old.lower * ratio), max(old.upper, old.upper * ratio)
    typical = (old.typical or 0) * (max(ratio, 1.0) if name in _LOSSES else ratio)
    moved[name] = dataclasses.replace(old, nominal=value, lower=lower, upper=upper, typical=typical)
  return parameters.replace(**moved)


def _open(name: str, nominal: float, factor: float, unit: str, symbol: str, std: float | None = None) -> Parameter:
  """A parameter known to an order of magnitude, unless a bench says better."""
  return Parameter(name, nominal, nominal / factor, nominal * factor, unit, symbol, std=std, typical=0.3 * nominal)


def _near(name: str, nominal: float, share: float, unit: str, symbol: str, factor: float) -> Parameter:
  """A parameter held near a figure typical of the class."""
  return Parameter(name, nominal, nominal / factor, nominal * factor, unit, symbol, std=share * nominal)


def _measured(name: str, nominal: float, std: float, unit: str, symbol: str) -> Parameter:
  return Parameter(name, nominal, 0.4 * nominal, 2.5 * nominal, unit, symbol, std=std)
