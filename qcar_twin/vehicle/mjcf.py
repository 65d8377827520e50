"""A car's numbers written into assets/qcar.xml.

Integration is semi-implicit Euler with the dampers explicit: what the contact solver takes for the velocity
at the end of the step then is that velocity, which an implicit damper outside the solver would spoil.
"""

import functools
import math

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from qcar_twin.vehicle.drive import largest_command
from qcar_twin.vehicle.similarity import AS_THE_QCAR, Similarity
from qcar_twin.vehicle.tyre import add_tyres, law_parameters, tyre_user_data
from qcar_twin.vehicle.vehicle import ASSETS, GRAVITY, QCAR, WHEELS, TyreKind, Vehicle

CENTRE_SWITCH = {"front_axle": False, "rear_axle": False, "axles": True, "centre": True}  # equalities of a differential
_LOOKS_GROUP = 2
_TWIN_SENSORS = ("accelerometer", "gyro", "encoder")
_TWIN_SITES = ("imu", "lidar")
_KNUCKLE_INERTIA = 2e-4  # of a road wheel with its share of the servo / mass of the car, m^2, of the QCar's class
_FASTEST_DAMPER = 1.1  # damping of a wheel's travel / its mass x the longest step: what that step, explicit, stands
_HALF_FREE, _LOCKED = 0.1, 0.98  # N m s/rad, of the QCar's class
_ONE_SHAFT = 1e-6  # centre differential below which nothing tells it from a shaft
FASTEST_SERVO = 1e3  # rad/s, stands for no limit


def car_spec(car: Vehicle, tyre: TyreKind = "contact", timestep: float = 0.002, looks: bool = False) -> mujoco.MjSpec:
  """The car on a floor, ready to compile or to build a world around.

  Args:
    car: its numbers.
    tyre: "contact" for the tyre inside the contact solver, "native" for MuJoCo's own friction.
    timestep: s.
    looks: keep the visual geoms, cameras and lights; without them a step costs a tenth less.
  """
  if tyre not in ("contact", "native"):
    raise ValueError(f"tyre must be 'contact' or 'native', not '{tyre}'")
  spec = _twin_file().copy()
  spec.modelname = car.name
  spec.option.timestep = timestep
  spec.option.gravity = [0.0, 0.0, -GRAVITY]
  _write_chassis(spec, car)
  _write_wheels(spec, car)
  _write_drive(spec, car)
  _write_centre(spec, car, timestep)
  _write_steering(spec, car, timestep)
  if tyre == "contact":
    add_tyres(spec, "chassis", {wheel: tyre_of(car, wheel) for wheel in WHEELS})
  else:
    _soften(spec)
  if looks:
    _stretch_looks(spec, car)
  else:
    _strip_looks(spec)
  return spec


def car_model(car: Vehicle, tyre: TyreKind = "contact", timestep: float = 0.002) -> mujoco.MjModel:
  """The car on a floor, compiled; arguments as `car_spec`.

  Raises:
    ValueError: no body can have these masses, inertias or lengths; in one line, with the vehicle's name.
  """
  spec = car_spec(car, tyre, timestep)
  try:
    return spec.compile()
  except ValueError as error:
    said = " ".join(str(error).removeprefix("Error: ").split())
    cure = "correct its masses, its yaw_inertia and its lengths"
    raise ValueError(f"vehicle '{car.name}' can't be built: {said}; {cure}") from error


def tyre_of(car: Vehicle, wheel: str) -> list[float]:
  """`geom_user` of a wheel: half its axle's cornering stiffness, at its static load."""
  front = wheel.startswith("front")
  axle = car.cornering_stiffness_front if front else car.cornering_stiffness_rear
  own = {p.name: getattr(car, p.name, p.nominal) for p in law_parameters(car.tyre_law)}
  return tyre_user_data(
    car.tyre_law,
    cornering_stiffness=axle / 2.0,
    longitudinal_stiffness=car.longitudinal_stiffness / 4.0,
    friction_coefficient=car.friction_coefficient,
    load_exponent=car.load_exponent,
    nominal_load=car.static_load[0 if front else 1],
    relaxation_length=car.relaxation_length,
    longitudinal_relaxation=car.longitudinal_relaxation,
    carcass_damping=car.carcass_damping,
    rim_mass=float(rim_mass(car, car.rotor_inertia, car.wheel_inertia)[0, WHEELS.index(wheel)]),
    **own,
  )


def rim_mass(car: Vehicle, rotor_inertia: ArrayLike, wheel_inertia: ArrayLike) -> np.ndarray:
  """What turns with each wheel, as a mass at its rim, kg, (n, 4): the wheel and, where driven, a share of the rotor.

  Args:
    rotor_inertia: on the motor's side, wheel_inertia: of one wheel about its axle, kg m^2, numbers or (n,).
  """
  driven = np.array([wheel.split("_")[0] in car.driven_axles for wheel in WHEELS], dtype=np.float64)
  rotor, wheel = (np.atleast_1d(np.asarray(i, dtype=np.float64))[:, None] for i in (rotor_inertia, wheel_inertia))
  return (wheel + driven / driven.sum() * rotor / car.gear_ratio**2) / car.wheel_radius**2


def differential_rows(damping: ArrayLike, timestep: float, invweight: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
  """Solver numbers that make equality `front_differential` or `rear_differential` a damper, torque = -b (w_l - w_r).

  A row with reference -v/h and regularisation R = 1/(h b) solves for -b times the speed at the end of the
  step: stable from open (switch the equality off) to locked. Write them to eq_solref and eq_solimp, and eq_active to 1.

  Args:
    damping: b, N m s/rad, (n,).
    timestep: h, s.
    invweight: tendon_invweight0 of the tendon of that name, 1/(kg m^2), a number or (n,).

  Returns:
    solref (n, 2) and solimp (n, 5).
  """
  strength = timestep * np.atleast_1d(np.asarray(damping, dtype=np.float64)) * np.asarray(invweight)
  impedance = np.clip(strength / (1.0 + strength), 1e-4, 0.9999)  # MuJoCo's own limits
  fixed = np.ones_like(impedance)
  solref = np.stack([-1e-9 * fixed, -impedance / timestep], axis=-1)
  return solref, np.stack([impedance, impedance, fixed, 0.5 * fixed, 2.0 * fixed], axis=-1)


def centre_damping(freedom: ArrayLike, similarity: Similarity = AS_THE_QCAR) -> np.ndarray:
  """Damping between the axles' mean wheel speeds, b = 0.1 (1 - x) / x N m s/rad, of a `centre_differential` x.

  At 0.1 a slow tight turn is half-way from one shaft to an open differential: there tyres hold the axles together by
  C_x R_w^2 / (4 v), 0.1 N m s/rad of the QCar at 1.5 m/s; of a car of another size by its similarity.
  """
  share = np.clip(np.asarray(freedom, dtype=np.float64), _ONE_SHAFT, 1.0)
  half_free = _HALF_FREE * similarity.mass * similarity.length**2 / similarity.time
  return half_free * (1.0 - share) / share


def locked_damping(similarity: Similarity = AS_THE_QCAR) -> float:
  """Damping of a locked axle, N m s/rad: at 0.2 rad/s between its wheels tyres hold no more, 0.8 x 6.6 N x 0.033 m."""
  return _LOCKED * similarity.mass * similarity.length**2 / similarity.time


def _write_chassis(spec: mujoco.MjSpec, car: Vehicle) -> None:
  chassis, motor = spec.body("chassis"), spec.body("motor")
  mass = car.mass - 4.0 * car.wheel_mass
  motor.mass *= car.similarity.mass
  motor.inertia = motor.inertia * car.similarity.mass * car.similarity.length**2
  chassis.pos = [0.0, 0.0, car.cg_height - sinking(car)]
  chassis.mass = mass - motor.mass
  chassis.ipos = -car.wheel_mass * car.wheel_positions.sum(axis=0) / mass
  motor.pos = chassis.ipos
  chassis.inertia = _chassis_inertia(car, mass)
  spec.site("imu").pos = [car.imu_x, car.imu_y, 0.0]
  scale = _scale(car)
  spec.site("lidar").pos = spec.site("lidar").pos * scale
  hull = spec.geom("chassis")
  hull.size, hull.pos = hull.size * scale, hull.pos * scale


def sinking(car: Vehicle) -> float:
  """How deep the wheels stand in the floor, m: load x R / stiffness of their contact."""
  time_constant, impedance, inverse_mass = _contact(car)
  return float(np.mean(car.static_load)) * (1.0 - impedance) * time_constant**2 * inverse_mass


def contact_row(car: Vehicle) -> tuple[float, float, float]:
  """Reference damping [1/s], stiffness [1/s^2] and regularisation R [1/kg] of a wheel's contact with the floor.

  MuJoCo's for a critical solref of time constant t and a solimp of d: 2 / (d t), d / (d t)^2 and (1 - d) / d times the
  contact's inverse mass.
  """
  time_constant, impedance, inverse_mass = _contact(car)
  damping, stiffness = 2.0 / (impedance * time_constant), 1.0 / (impedance * time_constant**2)
  return damping, stiffness, (1.0 - impedance) / impedance * inverse_mass


def _contact(car: Vehicle) -> tuple[float, float, float]:
  """Time constant [s] and impedance of the wheels' contact in qcar.xml, and what MuJoCo takes for its inverse mass.

  That is the mean of a wheel's along z, its own, and along x and y, nearly the car's.
  """
  return 2.0 * car.similarity.longest_step, 0.99, (1.0 / car.wheel_mass + 4.2 / car.mass) / 3.0


def wheel_half_width(car: Vehicle) -> float:
  """Half axis of the wheels' ellipsoid along the axle, m."""
  return 0.45 * car.wheel_radius


def _chassis_inertia(car: Vehicle, mass: float) -> list[float]:
  """Roll, pitch and yaw inertia of the sprung mass: yaw as measured, the others of a flat box over the wheels.

  Not too small for the dampers at a step of 5 ms, and a rigid body's: none exceeds the sum of the others.
  """
  yaw = car.chassis_yaw_inertia
  roll = max(0.35 * yaw, mass * (0.35 * car.track_width) ** 2)
  pitch = max(0.85 * yaw, mass * (0.30 * car.wheelbase) ** 2, 1.05 * roll - yaw)
  return [roll, min(pitch, 0.95 * (roll + yaw)), yaw]


def _write_wheels(spec: mujoco.MjSpec, car: Vehicle) -> None:
  sprung = car.mass - 4.0 * car.wheel_mass
  stiffness, step = sprung / 4.0 * (2.0 * math.pi * car.suspension_frequency) ** 2, car.similarity.longest_step
  damping = float(suspension_damping(stiffness, sprung, car.suspension_damping_ratio, car.wheel_mass, step))
  for wheel, position in zip(WHEELS, car.wheel_positions, strict=True):
    body, joint, geom = spec.body(wheel), spec.joint(f"{wheel}_suspension"), spec.geom(wheel)
    load = car.static_load[0 if wheel.startswith("front") else 1]
    body.pos, body.mass, body.inertia = position, car.wheel_mass, car.wheel_inertias
    joint.stiffness[0], joint.damping[0], joint.range = stiffness, damping, joint.range * car.similarity.length
    joint.springref = -(load - car.wheel_mass * GRAVITY) / stiffness
    spec.joint(f"{wheel}_spin").frictionloss = car.rolling_resistance * load * car.wheel_radius
    geom.size = [car.wheel_radius, wheel_half_width(car), car.wheel_radius]
    geom.friction[0], geom.solref[0] = car.friction_coefficient, _contact(car)[0]
  spec.geom("floor").friction[0] = car.friction_coefficient


def suspension_damping(
  stiffness: ArrayLike, sprung: float, ratio: ArrayLike, wheel_mass: float, step: float
) -> np.ndarray:
  """Of one wheel, N s/m: `ratio` of the bounce's critical damping, as far as the longest `step` [s] stands it.

  With k and c over the wheel's mass, semi-implicit Euler with explicit damping stands h^2 k + 2 h c < 4; a quarter is
  kept back.

  Args:
    stiffness: of one wheel's spring, N/m.  sprung: mass on all four, kg.
  """
  rate = np.asarray(stiffness, dtype=np.float64) / wheel_mass
  most = np.clip((3.0 - step**2 * rate) / (2.0 * step), 0.05 / step, _FASTEST_DAMPER / step)
  return np.minimum(np.asarray(ratio) * np.sqrt(np.asarray(stiffness) * sprung), most * wheel_mass)


def _write_drive(spec: mujoco.MjSpec, car: Vehicle) -> None:
  """Motor torque = K / R (u - K w), whatever the command u: K = damping / torque per command."""
  constant = car.motor_damping / car.torque_per_command
  motor = spec.actuator("motor")
  motor.gainprm[:2] = [constant / car.torque_per_command, constant]
  most = largest_command(car.drive, car.supply_voltage)
  if math.isfinite(most):
    motor.ctrlrange = [-most, most]
  else:
    motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
  if math.isfinite(car.max_torque):
    motor.forcelimited, motor.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-car.max_torque, car.max_torque]
  joint = spec.joint("motor")
  joint.armature, joint.frictionloss = car.rotor_inertia, car.driveline_friction
  for axle in ("front", "rear"):  # a tendon's path can't be edited in place
    spec.delete(spec.tendon(f"{axle}_axle"))
    if axle not in car.driven_axles:
      _free_axle(spec, axle)
      continue
    tendon = spec.add_tendon(name=f"{axle}_axle")
    tendon.wrap_joint(f"{axle}_left_spin", 0.5)
    tendon.wrap_joint(f"{axle}_right_spin", 0.5)
    tendon.wrap_joint("motor", -car.gear_ratio)


def _write_centre(spec: mujoco.MjSpec, car: Vehicle, timestep: float) -> None:
  """The differential between two driven axles: instead of both axles' equalities where there is one."""
  spec.delete(spec.tendon("axles"))
  if len(car.driven_axles) < 2:
    for part in (spec.equality("axles"), spec.equality("centre"), spec.tendon("centre")):
      spec.delete(part)
    return
  tendon = spec.add_tendon(name="axles")
  for wheel in WHEELS:
    tendon.wrap_joint(f"{wheel}_spin", 0.25)
  tendon.wrap_joint("motor", -car.gear_ratio)
  if car.centre_differential > 0.0:
    for name, active in CENTRE_SWITCH.items():
      spec.equality(name).active = active
    centre, weight = spec.equality("centre"), 1.0 / car.wheel_inertia  # what MuJoCo finds for its tendon
    rows = differential_rows(centre_damping(car.centre_differential, car.similarity), timestep, weight)
    (centre.solref,), (centre.solimp,) = rows


def _free_axle(spec: mujoco.MjSpec, axle: str) -> None:
  """Take an axle's differential out: its wheels roll each for itself."""
  for equality in (f"{axle}_axle", f"{axle}_differential"):
    spec.delete(spec.equality(equality))
  spec.delete(spec.tendon(f"{axle}_differential"))


def _write_steering(spec: mujoco.MjSpec, car: Vehicle, timestep: float) -> None:
  """The filter is the servo; with k = 2 J / h^2 and d = J / h the road wheels are where it points a step later."""
  servo, inertia = spec.actuator("steering"), knuckle_inertia(car)
  stiffness = 2.0 * inertia / timestep**2
  servo.dynprm[0], servo.actearly = car.servo_time_constant, True
  servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = stiffness, -stiffness, 0.0
  force = servo_force(min(car.servo_rate, FASTEST_SERVO), inertia, timestep)
  servo.ctrlrange, servo.forcerange = [-car.max_steering, car.max_steering], [-force, force]
  for wheel in WHEELS[:2]:
    joint = spec.joint(f"{wheel}_steering")
    joint.armature, joint.damping[0] = inertia - car.wheel_inertias[2], inertia / timestep
  spec.equality("ackermann").data[2] = car.ackermann_fraction * car.track_width / (2.0 * car.wheelbase)


def knuckle_inertia(car: Vehicle) -> float:
  """Of one road wheel about its steering axis with its share of the servo, kg m^2."""
  return _KNUCKLE_INERTIA * car.mass * car.similarity.length**2


def servo_force(rate: float, inertia: float, timestep: float) -> float:
  """Force range of the steering actuator, N m, at which road wheels of this inertia turn at `rate` [rad/s] at most."""
  return 2.0 * inertia / timestep * rate


def _scale(car: Vehicle) -> np.ndarray:
  """Size of this car over the QCar's along x, y, z."""
  return np.array([getattr(car, name) / getattr(QCAR, name) for name in ("wheelbase", "track_width", "wheel_radius")])


def _stretch_looks(spec: mujoco.MjSpec, car: Vehicle) -> None:
  scale, wheel = _scale(car), car.wheel_radius / QCAR.wheel_radius
  for geom in spec.geoms:
    if geom.group == _LOOKS_GROUP:
      on_wheel = geom.parent.name in WHEELS
      geom.pos = geom.pos * (wheel if on_wheel else scale)
      geom.size = geom.size * (wheel if on_wheel else scale.min())


def _soften(spec: mujoco.MjSpec) -> None:
  """Wheel contacts with MuJoCo's default softness, at which its own friction chatters least."""
  for wheel in WHEELS:
    geom = spec.geom(wheel)
    geom.solref, geom.solimp = [0.02, 1.0], [0.9, 0.95, 0.001, 0.5, 2.0]


def _strip_looks(spec: mujoco.MjSpec) -> None:
  """Take out what only a camera sees."""
  for geom in list(spec.geoms):
    if geom.group == _LOOKS_GROUP:
      spec.delete(geom)
  for part in [*spec.cameras, *spec.lights]:
    spec.delete(part)


@functools.cache
def _twin_file() -> mujoco.MjSpec:
  """assets/qcar.xml without what it offers to plain MuJoCo: keyframes, and sensors that would cost time in each step.

  It is read once per process, because MuJoCo takes 20 ms to lay out the lidar's beams. Callers copy it.
  """
  spec = mujoco.MjSpec.from_string((ASSETS / "qcar.xml").read_text(encoding="utf-8"))  # MuJoCo's own paths are UTF-8
  extra_sensors = [sensor for sensor in spec.sensors if sensor.name not in _TWIN_SENSORS]
  extra_sites = [site for site in spec.sites if site.name not in _TWIN_SITES]
  for part in [*spec.keys, *extra_sensors, *extra_sites]:
    spec.delete(part)
  return spec
