"""The parameters the base twin has, with their priors, and the quantities they stand for.

Each parameter is known in one of three ways, and the table in `base_parameters` says in which:

* measured: with a scale, a ruler or on a bench; the vehicle's description states the standard deviation, or the table
  does what such a measurement is good for.
* class: nobody measured it on this car. The nominal value is typical of small electric cars, and the prior is
  log-normal where it can only be positive: one standard deviation is then a factor. An independent simulated car had a
  slip stiffness of 98 N and a real one 44 N beside a nominal 540 N: a factor of 3 puts them at 1.6 and 2.3 deviations.
* open: known to an order of magnitude; the recordings decide.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.twin.engines import controller
from qcar_twin.vehicle.mjcf import locked_damping, rim_mass
from qcar_twin.vehicle.tyre import law_parameters, tyre_laws
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
WHEELS_AT_COMMAND = "wheels_at_command"
_LOSSES = ("motor_damping", "driveline_friction", "drive_damping", "drive_friction")
_BY_FACTORS = (
  "motor_damping", "driveline_friction", "rotor_inertia", "relaxation_length", "longitudinal_relaxation",
  "servo_time_constant",
)  # fmt: skip
_LOOP_REACH = 6.0  # times slower or faster than usual; a loop yet faster chatters at steps of 5 ms when the wheels slip


def base_parameters(vehicle: Vehicle) -> ParameterSet:
  """The base twin's parameters for a car, nominal values and priors from its numbers.

  Raises:
    ValueError: a number is 0 that is fitted by factors.
  """
  for name in _BY_FACTORS:
    if getattr(vehicle, name) == 0.0:
      raise ValueError(
        f"vehicle '{vehicle.name}': {name} is 0, which no calibration can scale; leave it out where nobody measured it"
      )
  v, std, motor = vehicle, vehicle.std, vehicle.motor
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
      _class(v, "rotor_inertia", 2.0, (1 / 3, 8.0), "kg m^2", "J_m"),
      # a cylinder's and a ring's differ by 2, tyres of foam and rubber by as much; what has no wheels that turn has 0
      _class(v, "wheel_inertia", 2.0, (1 / 50, 4.0), "kg m^2", "J_w"),
      _open("cornering_stiffness_front", v.cornering_stiffness_front, 8.0, "N/rad", "C_f"),
      _open("cornering_stiffness_rear", v.cornering_stiffness_rear, 8.0, "N/rad", "C_r"),
      _class(v, "longitudinal_stiffness", 3.0, (1 / 27, 8.0), "N", "C_x"),
      _class(v, "friction_coefficient", 1.3, (1 / 3, 3.0), "-", "mu"),
      *(dataclasses.replace(p, nominal=getattr(v, p.name, p.nominal), assumed=True)
        for p in law_parameters(v.tyre_law)),
      _class(v, "relaxation_length", 3.0, (1 / 20, 15.0), "m", "sigma"),
      # stiffness over that of the carcass, and both differ along and across: Pacejka 2012, ch. 7.2
      _class(v, "longitudinal_relaxation", 3.0, (1 / 20, 15.0), "m", "sigma_x"),
      _class(v, "servo_time_constant", 3.0, (1 / 5, 40.0), "s", "tau_s"),
      _measured("servo_inertia", v.servo_inertia, (0.0, 1.0), "-", "q_s", std, 0.25),
      _measured("ackermann_fraction", v.ackermann_fraction, (-1.0, 2.0), "-", "f_A", std, 0.5),
      _measured("mass", v.mass, (0.4 * v.mass, 2.5 * v.mass), "kg", "m", std, 0.02 * v.mass),
      _measured("yaw_inertia", v.yaw_inertia, (0.4 * v.yaw_inertia, 2.5 * v.yaw_inertia), "kg m^2", "I_G", std,
                0.1 * v.yaw_inertia),
      _measured("cg_to_front", v.cg_to_front, (0.2 * length, 0.8 * length), "m", "L_f", std, 0.01 * length),
      _measured("cg_height_offset", 0.0, (-0.8 * v.cg_height, 1.5 * v.cg_height), "m", "dh", std, 0.1 * v.cg_height),
      _measured("suspension_frequency", v.suspension_frequency,
                (0.25 * v.suspension_frequency, stiffest_suspension(v)), "Hz", "f_z", std,
                0.5 * v.suspension_frequency),
      *_centre(v),
      *_torque_limit(v),
      # no log says whether its first command had acted when it began: its own habit, not the car's; how the car turned
      # says where the wheels stood
      Parameter(WHEELS_AT_COMMAND, 0.0, 0.0, 1.0, "-", "w_0", std=0.5, assumed=True,
                description="share of the way to its first command that a recording's road wheels have gone"),
    )
  )  # fmt: skip


def _centre(vehicle: Vehicle) -> tuple[Parameter, ...]:
  """The differential between two driven axles: few descriptions of a car say whether there is one."""
  if len(vehicle.driven_axles) < 2:
    return ()
  return (_measured("centre_differential", vehicle.centre_differential, (0.0, 1.0), "-", "x_c", vehicle.std, 0.5),)


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
  semi-implicit Euler without damping stands 4. Half of what is left is for the damper (see mjcf.suspension_damping)."""
  sprung = vehicle.mass - 4.0 * vehicle.wheel_mass
  stable = np.sqrt(2.2 * 4.0 * vehicle.wheel_mass / sprung) / (2.0 * np.pi * vehicle.similarity.longest_step)
  return float(max(stable, 1.01 * vehicle.suspension_frequency))


def quantities(theta: Array, base: ParameterSet, vehicle: Vehicle) -> dict[str, Array]:
  """Simulator quantities of N cars from their parameters (N, P >= len(base)): (N,) or, per wheel, (N, 4)."""
  size = len(theta)
  column = {name: np.array(theta[:, i]) for i, name in enumerate(base.names) if name != WHEELS_AT_COMMAND}
  wheelwise = lambda value: np.tile(np.asarray(value, float).reshape(-1, 1), (size // np.size(value), 4))
  front, rear = column.pop("cornering_stiffness_front") / 2, column.pop("cornering_stiffness_rear") / 2
  out = {
    "torque_per_volt": column.pop(vehicle.motor.gain),
    "cornering_stiffness": np.stack([front, front, rear, rear], axis=-1),
    "longitudinal_stiffness": wheelwise(column.pop("longitudinal_stiffness") / 4),
    "friction_coefficient": wheelwise(column.pop("friction_coefficient")),
    "relaxation_length": wheelwise(column.pop("relaxation_length")),
    "longitudinal_relaxation": wheelwise(column.pop("longitudinal_relaxation")),
    "load_exponent": wheelwise(vehicle.load_exponent),
    "rim_mass": rim_mass(vehicle, column["rotor_inertia"], column["wheel_inertia"]),
    "suspension_damping_ratio": np.full(size, vehicle.suspension_damping_ratio),
    "servo_rate": np.full(size, vehicle.servo_rate),
    "differential_damping": np.full(size, locked_damping(vehicle.similarity) * (vehicle.differential == "locked")),
  }
  # a law the car's tyres don't follow has its parameters all the same, so that what changes them finds them
  own = {p.name: column.pop(p.name, np.array(p.nominal)) for law in tyre_laws().values() for p in law}
  out |= {name: wheelwise(value) for name, value in own.items()}
  zeros = ("driveline_damping", "differential_friction", "gravity_x", "gravity_y", "supply_sag")
  zeros += ("added_mass", "added_mass_x", "added_mass_y", "cg_lateral_offset", "steering_hold", "drive_hold")
  zeros += (*controller.QUANTITIES, "braked_at_first")
  return out | column | {name: np.zeros(size) for name in zeros}


def informed(parameters: ParameterSet, values: Mapping[str, float]) -> ParameterSet:
  """The same parameters with better first guesses: the nominal value and what goes by it move along.

  A first guess bounds nothing: bounds reach as far as those about the old value and those about the new one do
  together. Nor do steps shrink of a loss that is guessed to be next to nothing, where another effect may have hidden
  it. Only open parameters are moved.
  """
  moved = {}
  for name, value in values.items():
    old = parameters[name]
    if old.kind != "open" or not np.isfinite(value) or value <= 0 or old.nominal <= 0:
      continue
    ratio = value / old.nominal
    lower, upper = min(old.lower, old.lower * ratio), max(old.upper, old.upper * ratio)
    typical = (old.typical or 0) * (max(ratio, 1.0) if name in _LOSSES else ratio)
    moved[name] = dataclasses.replace(old, nominal=value, lower=lower, upper=upper, typical=typical)
  return parameters.replace(**moved)


def _open(name: str, nominal: float, factor: float, unit: str, symbol: str, std: float | None = None) -> Parameter:
  """A parameter known to an order of magnitude, unless a bench says better."""
  return Parameter(name, nominal, nominal / factor, nominal * factor, unit, symbol, std=std, typical=0.3 * nominal)


def _class(vehicle: Vehicle, name: str, factor: float, reach: tuple[float, float], unit: str, symbol: str) -> Parameter:
  """A figure typical of the class, one deviation of which is a factor, unless this car's own was measured; `reach`:
  bounds over the nominal value."""
  nominal, std = getattr(vehicle, name), vehicle.std.get(name)
  lower, upper = (nominal * share for share in reach)
  if std is not None:
    return Parameter(name, nominal, lower, upper, unit, symbol, std=std)
  return Parameter(name, nominal, lower, upper, unit, symbol, typical=0.3 * nominal, factor=factor)


def _measured(
  name: str,
  nominal: float,
  bounds: tuple[float, float],
  unit: str,
  symbol: str,
  std: Mapping[str, float],
  else_std: float,
) -> Parameter:
  """What a person measures: the vehicle's own deviation, or a usual one of such measurements."""
  stated = std.get("cg_height" if name == "cg_height_offset" else name)
  return Parameter(
    name, nominal, *bounds, unit, symbol, std=else_std if stated is None else stated, assumed=stated is None
  )
