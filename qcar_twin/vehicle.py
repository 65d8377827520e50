"""A 1:10 car as numbers, and those numbers as a MuJoCo model.

`Vehicle` holds what a person measures with a scale and a ruler, plus nominal figures of drive and
tyres. `Vehicle.spec()` writes them into assets/qcar.xml: any other car is the same file with other
numbers. Frame: x forward, y left, z up; the chassis frame has its origin at the car's centre of gravity.
"""

import dataclasses
import difflib
import logging
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from qcar_twin.tyre import add_tyres, tyre_user_data

log = logging.getLogger(__name__)

ASSETS = Path(__file__).resolve().parents[1] / "assets"
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
GRAVITY = 9.81  # m/s^2
TyreKind = Literal["contact", "native"]

_LOOKS_GROUP = 2
_KNUCKLE_INERTIA = 2e-4  # of a road wheel with its share of the servo / mass of the car, m^2
_SCALED = ("wheelbase", "track_width", "wheel_radius")  # what the looks are stretched with, along x, y, z


@dataclasses.dataclass(frozen=True)
class Vehicle:
  """Numbers of one car, SI units. Defaults are the Quanser QCar's.

  Attributes:
    mass: of the whole car, kg.  yaw_inertia: of the whole car about its CG, kg m^2.
    cg_to_front, cg_to_rear: from the CG to the axles, m.  cg_height: above the ground at rest, m.
    track_width: between wheel centres of an axle, m.  wheel_radius: rolling radius at rest, m.
    gear_ratio: wheel speed / motor speed.  max_steering: mean road-wheel angle at lock, rad.
    imu_x, imu_y: IMU ahead of and left of the CG, m.
    torque_per_volt: motor torque per volt at standstill, K/R, N m/V.
    motor_damping: torque lost per motor speed, K^2/R with everything viscous in it, N m s/rad.
    driveline_friction: Coulomb friction on the motor side, N m.  rotor_inertia: kg m^2, motor side.
    rolling_resistance: rolling drag of a wheel / its static load, as a torque in its joint.
    cornering_stiffness_front, _rear: per axle, N/rad.  longitudinal_stiffness: of four wheels, N per unit slip.
    friction_coefficient: peak force / load.  tyre_shape, load_exponent, relaxation_length [m],
    carcass_damping [N s/m per wheel]: see qcar_twin/tyre/parameters.py.
    servo_time_constant: s.  servo_rate: highest steering rate, rad/s; inf for none.
    ackermann_fraction: 0 parallel wheels, 1 both wheels aimed at the turning centre.
    wheel_mass: of one wheel with its carrier, kg.  wheel_inertia: about the axle, kg m^2.
    suspension_frequency: bounce, Hz.  suspension_damping_ratio: of that bounce.
    std: name -> standard deviation of the measured numbers.
  """

  name: str = "Quanser QCar"
  mass: float = 2.7
  yaw_inertia: float = 0.030
  cg_to_front: float = 0.128
  cg_to_rear: float = 0.128
  track_width: float = 0.170
  cg_height: float = 0.045
  wheel_radius: float = 0.033
  gear_ratio: float = (13 * 19) / (70 * 37)
  max_steering: float = 0.5236
  imu_x: float = 0.0
  imu_y: float = 0.0
  torque_per_volt: float = 0.0272
  motor_damping: float = 7.1e-5
  driveline_friction: float = 8.5e-3
  rotor_inertia: float = 2.0e-6
  rolling_resistance: float = 0.0
  cornering_stiffness_front: float = 180.0
  cornering_stiffness_rear: float = 180.0
  longitudinal_stiffness: float = 540.0
  friction_coefficient: float = 0.8
  tyre_shape: float = 1.4
  load_exponent: float = 0.15
  relaxation_length: float = 0.010
  carcass_damping: float = 40.0
  servo_time_constant: float = 0.005
  servo_rate: float = math.inf
  ackermann_fraction: float = 1.0
  wheel_mass: float = 0.1
  wheel_inertia: float = 6.0e-5
  suspension_frequency: float = 5.0
  suspension_damping_ratio: float = 0.6
  std: Mapping[str, float] = dataclasses.field(default_factory=dict)

  def __post_init__(self) -> None:
    for field in dataclasses.fields(self):
      value = getattr(self, field.name)
      if field.name in _MEASURED and not (isinstance(value, (int, float)) and value > 0.0):
        raise ValueError(f"vehicle '{self.name}': {field.name} must be a positive number, not {value!r}")
    if self.chassis_yaw_inertia <= 0.0:
      least = self.yaw_inertia - self.chassis_yaw_inertia
      raise ValueError(
        f"vehicle '{self.name}': yaw_inertia {self.yaw_inertia:g} kg m^2 is less than its wheels alone have"
        f" ({least:.3g}); correct yaw_inertia, or give a smaller wheel_mass"
      )

  @property
  def wheelbase(self) -> float:
    """Distance between the axles, m."""
    return self.cg_to_front + self.cg_to_rear

  @property
  def static_load(self) -> tuple[float, float]:
    """Load of one front and of one rear wheel at rest on level ground, N."""
    weight = self.mass * GRAVITY / 2.0
    return weight * self.cg_to_rear / self.wheelbase, weight * self.cg_to_front / self.wheelbase

  @property
  def wheel_positions(self) -> np.ndarray:
    """Wheel centres in the chassis frame, in the order of WHEELS, m, (4, 3)."""
    half, z = self.track_width / 2.0, self.wheel_radius - self.cg_height
    return np.array([(x, y, z) for x in (self.cg_to_front, -self.cg_to_rear) for y in (half, -half)])

  @property
  def chassis_yaw_inertia(self) -> float:
    """What is left for the sprung mass about its own CG so that the whole car has `yaw_inertia`, kg m^2."""
    wheels = self.wheel_positions[:, :2]
    body = self.mass - 4.0 * self.wheel_mass
    offset = -self.wheel_mass * wheels.sum(axis=0) / body
    apart = self.wheel_mass * np.sum(wheels**2) + body * np.sum(offset**2)
    return float(self.yaw_inertia - apart - 4.0 * self._wheel_inertias[2])

  @property
  def drive_inertia(self) -> float:
    """Inertia the motor turns, with the whole car rolling, kg m^2."""
    rolling = self.mass * self.wheel_radius**2 + 4.0 * self.wheel_inertia
    return self.rotor_inertia + rolling * self.gear_ratio**2

  @property
  def _wheel_inertias(self) -> tuple[float, float, float]:
    return 0.6 * self.wheel_inertia, self.wheel_inertia, 0.6 * self.wheel_inertia

  @classmethod
  def load(cls, path: str | Path = ASSETS / "qcar.toml") -> "Vehicle":
    """A car from a TOML file: `name`, and a table {value, unit, source, std} per number.

    Raises:
      ValueError: unknown or malformed entry, with the nearest valid name.
    """
    with open(path, "rb") as file:
      table = tomllib.load(file)
    name = str(table.pop("name", Path(path).stem))
    for key, entry in table.items():
      if not isinstance(entry, dict) or "value" not in entry:
        raise ValueError(f"{Path(path).name}: '{key}' must be a table with value, unit and source")
    values = {key: entry["value"] for key, entry in table.items()}
    std = {key: entry["std"] for key, entry in table.items() if "std" in entry}
    _known(values, Path(path).name)
    return cls(name=name, std=std, **values)

  @classmethod
  def from_dataset(cls, vehicle: Mapping[str, float | str], std: Mapping[str, float] | None = None) -> "Vehicle":
    """A car from a data set's [vehicle] table; what it doesn't give is the QCar's, scaled to this car's mass and wheels.

    A measured `motor_constant` [V s/rad] and `motor_resistance` [ohm] become torque_per_volt = K/R and
    motor_damping = K^2/R. Entries a vehicle does not have are said and left out.

    Args:
      vehicle: numbers by field name, and `name`.
      std: standard deviations by field name.
    """
    given = {key: value for key, value in vehicle.items() if key != "name"}
    given, std = _motor_figures(given, dict(std or {}))
    for key in set(given) - _field_names():
      near = difflib.get_close_matches(key, _field_names(), n=1)
      log.warning("[vehicle]: '%s' is not a number this twin knows and is left out%s", key,
                  f"; did you mean {near[0]}?" if near else "")
    numbers = {key: float(value) for key, value in given.items() if key in _field_names()}
    measured = cls(**{key: value for key, value in numbers.items() if key in _MEASURED and key != "yaw_inertia"})
    numbers = _scaled(measured) | numbers
    return cls(name=str(vehicle.get("name", "car")), std=std, **numbers)

  def spec(self, tyre: TyreKind = "contact", timestep: float = 0.002, looks: bool = False) -> mujoco.MjSpec:
    """The car on a floor.

    Args:
      tyre: "contact" for the tyre inside the contact solver, "native" for MuJoCo's own friction.
      timestep: s.
      looks: keep the visual geoms, cameras and lights; without them a step costs a tenth less.
    """
    if tyre not in ("contact", "native"):
      raise ValueError(f"tyre must be 'contact' or 'native', not '{tyre}'")
    spec = mujoco.MjSpec.from_file(str(ASSETS / "qcar.xml"))
    spec.modelname = self.name
    spec.option.timestep = timestep
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    self._write_chassis(spec)
    self._write_wheels(spec)
    self._write_drive(spec)
    self._write_steering(spec, timestep)
    if tyre == "contact":
      add_tyres(spec, "chassis", {wheel: self.tyre_user_data(wheel) for wheel in WHEELS})
    else:
      _soften(spec)
    self._stretch_looks(spec) if looks else _strip_looks(spec)
    return spec

  def tyre_user_data(self, wheel: str) -> list[float]:
    """`geom_user` of a wheel."""
    front = wheel.startswith("front")
    axle = self.cornering_stiffness_front if front else self.cornering_stiffness_rear
    return tyre_user_data(
      cornering_stiffness=axle / 2.0,
      longitudinal_stiffness=self.longitudinal_stiffness / 4.0,
      friction_coefficient=self.friction_coefficient,
      tyre_shape=self.tyre_shape,
      load_exponent=self.load_exponent,
      nominal_load=self.static_load[0 if front else 1],
      relaxation_length=self.relaxation_length,
      carcass_damping=self.carcass_damping,
    )

  def _write_chassis(self, spec: mujoco.MjSpec) -> None:
    chassis, mass, yaw = spec.body("chassis"), self.mass - 4.0 * self.wheel_mass, self.chassis_yaw_inertia
    motor = spec.body("motor")
    chassis.pos = [0.0, 0.0, self.cg_height]
    chassis.mass = mass - motor.mass
    chassis.ipos = -self.wheel_mass * self.wheel_positions.sum(axis=0) / mass
    motor.pos = chassis.ipos
    chassis.inertia = [0.35 * yaw, 0.85 * yaw, yaw]  # a flat box: roll, pitch, yaw
    spec.site("imu").pos = [self.imu_x, self.imu_y, 0.0]
    scale = self._scale
    spec.site("lidar").pos = spec.site("lidar").pos * scale
    hull = spec.geom("chassis")
    hull.size, hull.pos = hull.size * scale, hull.pos * scale

  def _write_wheels(self, spec: mujoco.MjSpec) -> None:
    sprung = self.mass - 4.0 * self.wheel_mass
    stiffness = sprung / 4.0 * (2.0 * math.pi * self.suspension_frequency) ** 2
    damping = self.suspension_damping_ratio * math.sqrt(stiffness * sprung)
    for wheel, position in zip(WHEELS, self.wheel_positions, strict=True):
      body, joint, geom = spec.body(wheel), spec.joint(f"{wheel}_suspension"), spec.geom(wheel)
      load = self.static_load[0 if wheel.startswith("front") else 1]
      body.pos, body.mass, body.inertia = position, self.wheel_mass, self._wheel_inertias
      joint.stiffness[0], joint.damping[0] = stiffness, damping
      joint.springref = -(load - self.wheel_mass * GRAVITY) / stiffness
      spec.joint(f"{wheel}_spin").frictionloss = self.rolling_resistance * load * self.wheel_radius
      geom.size = [self.wheel_radius, 0.45 * self.wheel_radius, self.wheel_radius]
      geom.friction[0] = spec.geom("floor").friction[0] = self.friction_coefficient

  def _write_drive(self, spec: mujoco.MjSpec) -> None:
    constant = self.motor_damping / self.torque_per_volt
    resistance = constant / self.torque_per_volt
    spec.actuator("motor").gainprm[:2] = [resistance, constant]
    joint = spec.joint("motor")
    joint.armature, joint.frictionloss = self.rotor_inertia, self.driveline_friction
    for axle in ("front", "rear"):  # a path can't be edited in place
      spec.delete(spec.tendon(f"{axle}_axle"))
      tendon = spec.add_tendon(name=f"{axle}_axle")
      tendon.wrap_joint(f"{axle}_left_spin", 0.5)
      tendon.wrap_joint(f"{axle}_right_spin", 0.5)
      tendon.wrap_joint("motor", -self.gear_ratio)

  def _write_steering(self, spec: mujoco.MjSpec, timestep: float) -> None:
    servo, lock = spec.actuator("steering"), self.max_steering
    # The filter is the servo; with k = 2 J / h^2 and d = J / h the road wheels are where it points a step later.
    inertia = _KNUCKLE_INERTIA * self.mass
    stiffness = 2.0 * inertia / timestep**2
    servo.dynprm[0], servo.actearly = self.servo_time_constant, True
    servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = stiffness, -stiffness, 0.0
    for wheel in WHEELS[:2]:
      joint = spec.joint(f"{wheel}_steering")
      joint.armature, joint.damping[0] = inertia - self._wheel_inertias[2], inertia / timestep
    force = 2.0 * inertia / timestep * min(self.servo_rate, 1e3)  # what moves them at servo_rate against d
    servo.ctrlrange, servo.forcerange = [-lock, lock], [-force, force]
    spec.equality("ackermann").data[2] = self.ackermann_fraction * self.track_width / (2.0 * self.wheelbase)

  @property
  def _scale(self) -> np.ndarray:
    """Size of this car over the QCar's along x, y, z."""
    return np.array([getattr(self, name) / getattr(_QCAR, name) for name in _SCALED])

  def _stretch_looks(self, spec: mujoco.MjSpec) -> None:
    scale, wheel = self._scale, self.wheel_radius / _QCAR.wheel_radius
    for geom in spec.geoms:
      if geom.group == _LOOKS_GROUP:
        on_wheel = geom.parent.name in WHEELS
        geom.pos = geom.pos * (wheel if on_wheel else scale)
        geom.size = geom.size * (wheel if on_wheel else scale.min())


@dataclasses.dataclass(frozen=True)
class Handles:
  """Places of the car's named parts in a compiled model.

  Attributes:
    chassis: body id.  wheels: geom ids, (4,).  spin_dofs, suspension_dofs: (4,).
    steering_qpos: qpos addresses of the two knuckles, (2,).  motor_dof: int.
    motor, steering: control addresses.  accelerometer, gyro, encoder: addresses in sensordata.
  """

  chassis: int
  wheels: tuple[int, ...]
  spin_dofs: tuple[int, ...]
  suspension_dofs: tuple[int, ...]
  steering_qpos: tuple[int, ...]
  motor_dof: int
  motor: int
  steering: int
  accelerometer: int
  gyro: int
  encoder: int

  @classmethod
  def of(cls, model: mujoco.MjModel, prefix: str = "") -> "Handles":
    """Handles of the car whose names carry `prefix`, as after MjSpec.attach."""
    dof = lambda name: int(model.joint(prefix + name).dofadr[0])  # noqa: E731
    sensor = lambda name: int(model.sensor(prefix + name).adr[0])  # noqa: E731
    return cls(
      chassis=model.body(prefix + "chassis").id,
      wheels=tuple(model.geom(prefix + wheel).id for wheel in WHEELS),
      spin_dofs=tuple(dof(f"{wheel}_spin") for wheel in WHEELS),
      suspension_dofs=tuple(dof(f"{wheel}_suspension") for wheel in WHEELS),
      steering_qpos=tuple(int(model.joint(f"{prefix}{wheel}_steering").qposadr[0]) for wheel in WHEELS[:2]),
      motor_dof=dof("motor"),
      motor=int(model.actuator_ctrladr[model.actuator(prefix + "motor").id]),
      steering=int(model.actuator_ctrladr[model.actuator(prefix + "steering").id]),
      accelerometer=sensor("accelerometer"),
      gyro=sensor("gyro"),
      encoder=sensor("encoder"),
    )


def differential_rows(damping: ArrayLike, timestep: float, invweight: float) -> tuple[np.ndarray, np.ndarray]:
  """Solver numbers that make the equality `front_differential` or `rear_differential` a damper, torque = -b (w_l - w_r).

  A row with reference -v/h and regularisation R = 1/(h b) solves for -b times the speed at the end of the
  step: stable from open (switch the equality off) to locked. Write them to eq_solref and eq_solimp, and eq_active to 1.

  Args:
    damping: b, N m s/rad, (n,).
    timestep: h, s.
    invweight: tendon_invweight0 of the tendon of that name, 1/(kg m^2).

  Returns:
    solref (n, 2) and solimp (n, 5).
  """
  strength = timestep * np.atleast_1d(np.asarray(damping, dtype=np.float64)) * invweight
  impedance = np.clip(strength / (1.0 + strength), 1e-4, 0.9999)  # MuJoCo's own limits
  fixed = np.ones_like(impedance)
  solref = np.stack([-1e-9 * fixed, -impedance / timestep], axis=-1)
  return solref, np.stack([impedance, impedance, fixed, 0.5 * fixed, 2.0 * fixed], axis=-1)


_MEASURED = (
  "mass",
  "yaw_inertia",
  "cg_to_front",
  "cg_to_rear",
  "track_width",
  "cg_height",
  "wheel_radius",
  "gear_ratio",
  "max_steering",
)
_QCAR = Vehicle()


def _field_names() -> set[str]:
  return {field.name for field in dataclasses.fields(Vehicle)} - {"name", "std"}


def _motor_figures(
  given: dict[str, float | str], std: dict[str, float]
) -> tuple[dict[str, float | str], dict[str, float]]:
  """K and R of a motor's data sheet or bench as torque per volt and damping, with their standard deviations.

  The damping's is widened by 15 %: the bench does not see bearings and gears.
  """
  given = dict(given)
  constant, resistance = given.pop("motor_constant", None), given.pop("motor_resistance", None)
  if constant is None or resistance is None:
    return given, std
  k, r = float(constant), float(resistance)
  share_k, share_r = std.pop("motor_constant", 0.05 * k) / k, std.pop("motor_resistance", 0.1 * r) / r
  given.setdefault("torque_per_volt", k / r)
  given.setdefault("motor_damping", k**2 / r)
  std.setdefault("torque_per_volt", k / r * math.hypot(share_k, share_r))
  std.setdefault("motor_damping", k**2 / r * math.hypot(2.0 * share_k, share_r, 0.15))
  return given, std


def _known(values: Mapping[str, object], where: str) -> None:
  """Raise for names a vehicle does not have."""
  names = sorted(_field_names())
  for key in values:
    if key not in names:
      near = difflib.get_close_matches(key, names, n=2) or names[:9]
      raise ValueError(f"{where}: a vehicle has no '{key}'; did you mean {', '.join(near)}?")


def _scaled(car: Vehicle) -> dict[str, float]:
  """The QCar's nominal drive, tyre and wheel numbers, carried over to a car of another mass and size.

  Per weight the tyres are the same, per volt and per second the drive is: acceleration per volt, rate of
  decay and friction deceleration are kept.
  """
  load, radius = car.mass / _QCAR.mass, car.wheel_radius / _QCAR.wheel_radius
  gear = car.gear_ratio / _QCAR.gear_ratio
  inertia = load * (radius * gear) ** 2
  front = car.static_load[0] / _QCAR.static_load[0]
  rear = car.static_load[1] / _QCAR.static_load[1]
  size = car.wheelbase / _QCAR.wheelbase
  return {
    "torque_per_volt": _QCAR.torque_per_volt * inertia / (radius * gear),
    "motor_damping": _QCAR.motor_damping * inertia,
    "driveline_friction": _QCAR.driveline_friction * inertia / (radius * gear),
    "rotor_inertia": _QCAR.rotor_inertia * inertia,
    "cornering_stiffness_front": _QCAR.cornering_stiffness_front * front,
    "cornering_stiffness_rear": _QCAR.cornering_stiffness_rear * rear,
    "longitudinal_stiffness": _QCAR.longitudinal_stiffness * load,
    "carcass_damping": _QCAR.carcass_damping * load,
    "wheel_mass": _QCAR.wheel_mass * load,
    "wheel_inertia": _QCAR.wheel_inertia * load * radius**2,
    "yaw_inertia": _QCAR.yaw_inertia * load * size**2,
  }


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
