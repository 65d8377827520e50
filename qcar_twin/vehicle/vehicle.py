"""A 1:10 car as numbers: what a person measures with a scale and a ruler, and nominal figures of drive and tyres.

Any car is the same model with other numbers: `mjcf.car_spec` writes them into assets/qcar.xml.
Frame: x forward, y left, z up; the origin of the chassis is the car's centre of gravity.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from qcar_twin.untrusted import UnreadableFile, is_number, read_toml
from qcar_twin.vehicle.drive import DIFFERENTIALS, DRIVEN_AXLES, DRIVES, Drive, DriveKind, Layout, motor_figures
from qcar_twin.vehicle.entries import meant, refuse_misspelt, refuse_unknown, say_left_out
from qcar_twin.vehicle.similarity import POWERS, Similarity, estimates

_INSTALLED = Path(__file__).resolve().parents[1] / "assets"  # within the package, as a wheel installs it
ASSETS = _INSTALLED if _INSTALLED.is_dir() else Path(__file__).resolve().parents[2] / "assets"  # a checkout
GRAVITY = 9.81  # m/s^2
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
TyreKind = Literal["contact", "native"]


@dataclasses.dataclass(frozen=True)
class Vehicle:
  """Numbers of one car, SI units. Defaults are the Quanser QCar's.

  Attributes:
    mass: of the whole car, kg.  yaw_inertia: of the whole car about its CG, kg m^2.
    cg_to_front, cg_to_rear: from the CG to the axles, m.  cg_height: above the ground at rest, m.
    track_width: between wheel centres of an axle, m.  wheel_radius: rolling radius at rest, m.
    gear_ratio: wheel speed / motor speed.  max_steering: mean road-wheel angle at lock, rad.
    imu_x, imu_y: IMU ahead of and left of the CG, m.
    layout: axles the motor turns, "all-wheel", "rear" or "front"; the wheels of another axle roll free.
    differential: of driven axles, "open", "locked" (a spool) or "unknown"; unsaid of one driven axle it is the last.
    centre_differential: between two driven axles, 0 one shaft, 1 an open differential; see mjcf.centre_damping.
    drive: what the motor is commanded with, one of DRIVES in qcar_twin/vehicle/drive.py.
    supply_voltage: of the battery, V: what a duty of 1 puts on the motor where no battery's voltage was logged, and the
      most a commanded voltage can be.
    torque_per_volt: motor torque per volt at standstill, K/R, N m/V; of a drive by voltage or duty.
    torque_per_ampere (K, N m/A), torque_per_speed (N m s/m), torque_per_acceleration (N m s^2/m): of such drives.
    motor_damping: torque lost per motor speed, N m s/rad: K^2/R with everything viscous in it; the viscous part alone
      where the current is commanded, the gain of the loop where the speed is.
    max_torque: most the motor's electronics let it give, N m, motor side; inf for no limit.
    driveline_friction: Coulomb friction on the motor side, N m.  rotor_inertia: kg m^2, motor side.
    rolling_resistance: rolling drag of a wheel / its static load, as a torque in its joint.
    cornering_stiffness_front, _rear: per axle, N/rad.  longitudinal_stiffness: of four wheels, N per unit slip.
    tyre_law: one of qcar_twin/vehicle/tyre/laws.  friction_coefficient: peak force / load.
    tyre_shape, load_exponent, carcass_damping [N s/m per wheel]: see qcar_twin/vehicle/tyre/parameters.py.
    relaxation_length, longitudinal_relaxation: distance rolled within which force follows slip across and along, m.
    servo_time_constant: s, lag at low frequencies.  servo_inertia: 1 / (2 zeta)^2, 0 of first order, see
      qcar_twin/twin/engines/servo.py.  servo_rate: highest steering rate, rad/s; inf for none.
    ackermann_fraction: 0 parallel wheels, 1 both wheels aimed at the turning centre.
    wheel_mass: of one wheel with its carrier, kg.  wheel_inertia: about the axle, kg m^2.
    suspension_frequency: bounce, Hz.  suspension_damping_ratio: of that bounce.
    std: name -> standard deviation of the measured numbers.
  """

  name: str = "Quanser QCar"
  tyre_law: str = "sine"
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
  layout: Layout = "all-wheel"
  differential: str = "open"
  centre_differential: float = 0.0
  drive: DriveKind = "voltage"
  supply_voltage: float = 12.0
  torque_per_volt: float = 0.0272
  torque_per_ampere: float = 7.1e-5 / 0.0272
  torque_per_speed: float = 7.1e-5 / 0.033 * (70 * 37) / (13 * 19)
  torque_per_acceleration: float = 0.00983
  max_torque: float = math.inf
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
  longitudinal_relaxation: float = 0.010
  carcass_damping: float = 40.0
  servo_time_constant: float = 0.005
  servo_inertia: float = 0.0
  servo_rate: float = math.inf
  ackermann_fraction: float = 1.0
  wheel_mass: float = 0.1
  wheel_inertia: float = 6.0e-5
  suspension_frequency: float = 8.0
  suspension_damping_ratio: float = 0.6
  std: Mapping[str, float] = dataclasses.field(default_factory=dict)

  def __post_init__(self) -> None:
    for field in dataclasses.fields(self):
      name, value = field.name, vars(self)[field.name]
      if isinstance(field.default, str) and not isinstance(value, str):
        raise ValueError(f"vehicle: {name} must be text, not {value!r:.60}")
      if not isinstance(field.default, float):
        continue
      least = -math.inf if name in _EITHER_SIGN else 0.0
      if not is_number(value, name in _UNLIMITED) or float(value) < least or (value == 0.0 and name not in _MAY_VANISH):
        what = "finite" if least else "non-negative" if name in _MAY_VANISH else "positive"
        raise ValueError(f"vehicle '{self.name}': {name} must be a {what} number, not {value!r:.60}")
      object.__setattr__(self, name, float(value))  # an integer beyond 64 bits is no number to NumPy
    for name, value in self.std.items():
      if not is_number(value) or value <= 0.0:
        raise ValueError(f"vehicle '{self.name}': the std of {name} must be a positive number, not {value!r:.60}")
    for name, known in _CHOICES.items():
      if (value := getattr(self, name)) not in known:
        said = f"{name} must be one of {', '.join(known)}, not {value!r}{meant(value, known)}"
        raise ValueError(f"vehicle '{self.name}': {said}")
    if self.centre_differential > 1.0:
      said = f"centre_differential must be from 0 (one shaft) to 1 (open), not {self.centre_differential:g}"
      raise ValueError(f"vehicle '{self.name}': {said}")
    if self.chassis_yaw_inertia <= 0.0:
      least = self.yaw_inertia - self.chassis_yaw_inertia
      raise ValueError(
        f"vehicle '{self.name}': yaw_inertia {self.yaw_inertia:g} kg m^2 is less than its wheels alone have"
        f" ({least:.3g}); correct yaw_inertia, or give a smaller wheel_mass"
      )

  @property
  def motor(self) -> Drive:
    """The kind of drive command."""
    return DRIVES[self.drive]

  @property
  def commands(self) -> tuple[str, str]:
    """Channels of the drive's and the steering's command."""
    return self.motor.channel, "steering_command"

  @property
  def command_scale(self) -> float:
    """What the drive's command is multiplied by before it meets the motor's law: volts per duty, else 1."""
    return self.supply_voltage if self.drive == "duty" else 1.0

  @property
  def torque_per_command(self) -> float:
    """Motor torque per scaled command at standstill, in `motor.gain_unit`."""
    return getattr(self, self.motor.gain)

  @property
  def driven_axles(self) -> tuple[str, ...]:
    """Those the motor turns, "front" before "rear"."""
    return DRIVEN_AXLES[self.layout]

  @property
  def wheelbase(self) -> float:
    """Distance between the axles, m."""
    return self.cg_to_front + self.cg_to_rear

  @property
  def similarity(self) -> Similarity:
    """How figures of the QCar's class are carried over to a car of this size."""
    return Similarity.of(self.wheelbase)

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
    return float(self.yaw_inertia - apart - 4.0 * self.wheel_inertias[2])

  @property
  def drive_inertia(self) -> float:
    """Inertia the motor turns, with the whole car rolling, kg m^2."""
    rolling = self.mass * self.wheel_radius**2 + 4.0 * self.wheel_inertia
    return self.rotor_inertia + rolling * self.gear_ratio**2

  @property
  def wheel_inertias(self) -> tuple[float, float, float]:
    """Of a wheel about its x, y (axle) and z axis, kg m^2."""
    return 0.6 * self.wheel_inertia, self.wheel_inertia, 0.6 * self.wheel_inertia

  @classmethod
  def load(cls, path: str | Path = ASSETS / "qcar.toml") -> "Vehicle":
    """A car from a TOML file: `name`, `layout`, `drive`, and a table {value, unit, source, std} per number.

    What it lacks is filled in as by `from_dataset`.

    Raises:
      UnreadableFile: unknown or malformed entry, with the nearest valid name.
    """
    table = read_toml(path)
    try:
      return cls._of_figures(table, Path(path).stem)
    except (ValueError, OverflowError) as error:
      raise UnreadableFile(f"{Path(path).name}: {error}") from error

  @classmethod
  def _of_figures(cls, table: dict[str, Any], stem: str) -> "Vehicle":
    """A car from a file's entries."""
    texts = {key: str(table.pop(key)) for key in ("name", *_CHOICES) if key in table}
    for key, entry in table.items():
      if not isinstance(entry, dict) or "value" not in entry:
        raise ValueError(f"'{key}' must be a table with value, unit and source")
    values = {key: entry["value"] for key, entry in table.items()}
    std = {key: entry["std"] for key, entry in table.items() if "std" in entry}
    refuse_unknown(values, _field_names())
    if wrong := [key for key, value in (*values.items(), *std.items()) if not is_number(value, infinite=True)]:
      raise ValueError(f"value and std of '{wrong[0]}' must be numbers")
    return cls._of_table({"name": stem} | texts | values, std)

  @classmethod
  def from_dataset(cls, vehicle: Mapping[str, float | str], std: Mapping[str, float] | None = None) -> "Vehicle":
    """A car from a data set's [vehicle] table; what it lacks is the QCar's, scaled to this car's mass and wheels;
    sizes too, by the wheelbase, where that is not within half to twice the QCar's.

    A measured `motor_constant` [V s/rad] and `motor_resistance` [ohm] become torque_per_volt = K/R and
    motor_damping = K^2/R, or torque_per_ampere = K where the current is commanded; with `max_current` [A] K gives
    max_torque. Entries a vehicle does not have are said and left out.

    Args:
      vehicle: numbers by field name, `name`, words (`layout`, `drive`, `differential`, `tyre_law`).
      std: standard deviations by field name.

    Raises:
      ValueError: a misspelt entry, with the nearest, or a number or word that no car has.
    """
    try:
      refuse_misspelt((*vehicle, *(std or {})), (*_field_names(), "name", *_WORDS))
      return cls._of_table(vehicle, std)
    except ValueError as error:
      raise ValueError(f"dataset.toml: [vehicle] {error}") from error

  @classmethod
  def _of_table(cls, vehicle: Mapping[str, float | str], std: Mapping[str, float] | None) -> "Vehicle":
    texts: dict[str, Any] = {key: str(vehicle[key]) for key in _WORDS if key in vehicle}
    texts = {"differential": "open" if texts.get("layout", "all-wheel") == "all-wheel" else "unknown"} | texts
    given = {key: value for key, value in vehicle.items() if key not in ("name", *_WORDS)}
    given, std = motor_figures(given, dict(std or {}), texts.get("drive", "voltage"))
    for key in sorted((set(given) | set(std)) - _field_names()):
      say_left_out(key, texts.get("drive", "voltage"), tuple(_field_names()))
    numbers: dict[str, Any] = {key: float(value) for key, value in given.items() if key in _field_names()}
    name, numbers = str(vehicle.get("name", "car")), numbers | _unsaid(numbers)
    sizes = {key: value for key, value in numbers.items() if key in _MEASURED and key != "yaw_inertia"}
    measured = cls(name=name, **texts, **sizes, wheel_mass=_WEIGHTLESS)
    numbers = _scaled(measured, numbers.get("yaw_inertia")) | numbers
    return cls(name=name, std=std, **texts, **numbers)


_MEASURED = (
  "mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius", "gear_ratio",
  "max_steering", "supply_voltage",
)  # fmt: skip
_EITHER_SIGN = ("imu_x", "imu_y", "ackermann_fraction")
_MAY_VANISH = (
  *_EITHER_SIGN, "centre_differential", "motor_damping", "driveline_friction", "rotor_inertia", "rolling_resistance",
  "load_exponent", "relaxation_length", "longitudinal_relaxation", "carcass_damping", "servo_time_constant",
  "servo_inertia", "suspension_damping_ratio", "tyre_shape",
)  # fmt: skip
_UNLIMITED = ("max_torque", "servo_rate")
_CHOICES = {"layout": tuple(DRIVEN_AXLES), "drive": tuple(DRIVES), "differential": DIFFERENTIALS}
_WORDS = (*_CHOICES, "tyre_law")
_LOOP_TIME = 0.1  # s, in which a usual speed loop brings a car of the QCar's class to its speed
_FIERCEST = 0.5 * GRAVITY  # m/s^2, acceleration that a usual limit of the motor's current allows
_SERVO_LAG = 0.02  # s, stated prior: the QCar's servo is taken for 5 ms, those of model cars for 15 to 75
_WEIGHTLESS = 1e-9  # kg, wheels of a car of which only sizes are used: the QCar's yaw inertia says nothing of it
_VISCOUS = 0.05  # of the motor's damping by back-EMF: what bearings, brushes and gears usually add
QCAR = Vehicle()


def _field_names() -> set[str]:
  return {field.name for field in dataclasses.fields(Vehicle)} - {"name", "std", *_WORDS}


def _unsaid(numbers: Mapping[str, float]) -> dict[str, float]:
  """Sizes that nobody said of a car that is not of the QCar's class: as its wheelbase makes them probable."""
  if not {"cg_to_front", "cg_to_rear"} <= numbers.keys() or min(numbers["cg_to_front"], numbers["cg_to_rear"]) <= 0.0:
    return {}
  if Similarity.of(numbers["cg_to_front"] + numbers["cg_to_rear"]).length == 1.0:
    return {}
  return estimates(numbers, {name: getattr(QCAR, name) for name in POWERS})


def _scaled(car: Vehicle, yaw_inertia: float | None) -> dict[str, float]:
  """The QCar's nominal drive, tyre and wheel numbers, carried over to a car of another mass and size.

  Per weight the tyres are the same, and so are the drive's acceleration per volt and its friction's deceleration.
  Lengths, times and rates of decay go by the car's similarity.
  """
  load, radius = car.mass / QCAR.mass, car.wheel_radius / QCAR.wheel_radius
  gear = car.gear_ratio / QCAR.gear_ratio
  inertia = load * (radius * gear) ** 2
  front, rear = (its / usual for its, usual in zip(car.static_load, QCAR.static_load, strict=True))
  yaw_inertia = yaw_inertia or QCAR.yaw_inertia * load * (car.wheelbase / QCAR.wheelbase) ** 2
  # wheels that hold at most half of the yaw inertia, whatever was measured
  heaviest = 0.5 * yaw_inertia / float(np.sum(car.wheel_positions[:, :2] ** 2))
  return _scaled_drive(car, inertia, radius * gear) | {
    "driveline_friction": QCAR.driveline_friction * inertia / (radius * gear),
    "rotor_inertia": QCAR.rotor_inertia * inertia,
    "cornering_stiffness_front": QCAR.cornering_stiffness_front * front,
    "cornering_stiffness_rear": QCAR.cornering_stiffness_rear * rear,
    "longitudinal_stiffness": QCAR.longitudinal_stiffness * load,
    "relaxation_length": QCAR.relaxation_length * car.similarity.length,
    "longitudinal_relaxation": QCAR.longitudinal_relaxation * car.similarity.length,
    "carcass_damping": QCAR.carcass_damping * load / car.similarity.time,
    "servo_time_constant": _SERVO_LAG * car.similarity.time,
    "suspension_frequency": QCAR.suspension_frequency / car.similarity.time,
    "wheel_mass": min(QCAR.wheel_mass * load, heaviest),
    "wheel_inertia": QCAR.wheel_inertia * load * radius**2,
    "yaw_inertia": yaw_inertia,
  }


def _scaled_drive(car: Vehicle, inertia: float, rolling: float) -> dict[str, float]:
  """Torque per command, damping and torque limit of a usual drive of the car's kind.

  Args:
    inertia: the car's at the motor, over the QCar's.  rolling: travel per turn of the motor, over the QCar's.
  """
  damping = QCAR.motor_damping * inertia / car.similarity.time
  if car.drive == "current":
    return {"torque_per_ampere": QCAR.torque_per_ampere * inertia / rolling, "motor_damping": _VISCOUS * damping}
  travel = car.gear_ratio * car.wheel_radius
  if car.drive == "acceleration":
    return {"torque_per_acceleration": QCAR.drive_inertia * inertia / travel, "motor_damping": _VISCOUS * damping}
  if car.drive == "speed":
    loop = QCAR.drive_inertia * inertia / (_LOOP_TIME * car.similarity.time)
    return {"torque_per_speed": loop / travel, "motor_damping": loop, "max_torque": car.mass * _FIERCEST * travel}
  return {"torque_per_volt": QCAR.torque_per_volt * inertia / rolling, "motor_damping": damping}
