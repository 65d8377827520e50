"""Cars far from the QCar: other weights, speeds, locks and supplies, several effects at once, sensors as logs have.

A wild session has the compact design's manoeuvres, scaled to what the car can do; its effects are of the same classes,
and its seed decides everything.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..laboratory.manoeuvres import SPACING, Manoeuvre, Path
from .car import GRAVITY, Car
from .drivetrain import LIMIT, Drivetrain
from .sensing import Sensors

DESIGN = "wild"
FASTEST = (2.0, 6.0)  # m/s, at nine tenths of the largest command
USUAL_FASTEST = 2.7  # m/s, of the compact design
STEEPEST = 8.0  # m/s^2 across, in the fast circles
CIRCLES = (1.5, np.radians(10.0))  # m/s and rad, of them

# (effects of which at most one is there, how often one of them is, sizes in multiples of the typical one)
POOLS: tuple[tuple[tuple[str, ...], float, tuple[float, float]], ...] = (
  (("steering_saturation", "steering_nonlinearity", "steering_gain_error", "steering_asymmetry"), 0.85, (0.7, 2.5)),
  (("drive_chopped", "drive_dead_zone", "drive_asymmetry", "coast_freewheel"), 0.85, (0.5, 1.3)),
  (("steering_delay",), 0.6, (0.3, 2.5)),
  (("drive_delay",), 0.4, (0.3, 2.8)),
  (("steering_lag", "steering_backlash", "steering_compliance"), 0.4, (0.5, 1.5)),
  (("drive_lag", "battery_sag", "motor_heating"), 0.4, (0.5, 1.5)),
  (("session_trim", "steering_offset"), 0.6, (0.5, 1.5)),
  (("quadratic_drag", "coulomb_friction", "steering_drag", "stiction"), 0.5, (0.7, 2.0)),
  (("tyre_relaxation", "load_transfer", "friction_change", "differential_lock"), 0.4, (0.7, 1.5)),
  (("cg_lateral_offset", "payload", "floor_slope"), 0.3, (0.7, 1.5)),
  (("gyro_scale",), 0.4, (0.4, 1.2)),
  (("imu_latency", "pose_latency"), 0.5, (0.4, 1.5)),
)
FEWEST, MOST = 4, 8


def draw_wild_car(rng: np.random.Generator) -> Car:
  """0.5 to 4 kg, commanded a voltage or a duty, up to 6 m/s."""
  mass, wheelbase = float(np.exp(rng.uniform(np.log(0.5), np.log(4.0)))), rng.uniform(0.16, 0.34)
  front = wheelbase * rng.uniform(0.42, 0.56)
  rear, radius, gear = wheelbase - front, rng.uniform(0.022, 0.055), 1.0 / rng.uniform(6.0, 13.0)
  load_front, load_rear = (0.5 * mass * GRAVITY * arm / wheelbase for arm in (rear, front))
  grip = rng.uniform(6.0, 13.0)
  train = Drivetrain() if rng.random() < 0.5 else Drivetrain(command="duty", supply=float(rng.choice([7.4, 11.1])))
  volts = 0.9 * (LIMIT["voltage"] if train.command == "voltage" else LIMIT["duty"] * train.supply)
  motor = rng.uniform(*FASTEST) / (radius * gear)
  constant = 0.85 * volts / motor  # the rest of the voltage goes into friction
  # stalled at half the largest command it would just pull itself up a slope of 1/3
  stall = 0.5 * volts / 0.9 * constant / (mass * GRAVITY / 3.0 * radius * gear)
  return Car(
    mass=mass, cg_to_front=front, cg_to_rear=rear, yaw_inertia=mass * front * rear * rng.uniform(0.6, 1.0),
    track_width=wheelbase * rng.uniform(0.6, 0.8), cg_height=radius * rng.uniform(0.9, 1.5), wheel_radius=radius,
    wheel_inertia=0.5 * 0.02 * mass * radius**2, gear_ratio=gear, max_steering=rng.uniform(0.3, 0.6),
    ackermann=rng.uniform(0.0, 1.0), servo_rate=rng.uniform(100.0, 340.0),
    motor_constant=constant, motor_resistance=stall * rng.uniform(0.6, 1.0),
    motor_inertia=rng.uniform(0.05, 0.15) * mass * (radius * gear) ** 2, motor_viscous=1e-3 * constant / motor,
    motor_coulomb=rng.uniform(0.01, 0.03) * mass * GRAVITY * radius * gear, shaft_stiffness=10.0 * mass,
    shaft_damping=5e-3 * mass, cornering_front=grip * load_front,
    cornering_rear=grip * rng.uniform(1.0, 1.3) * load_rear,
    slip_stiffness=rng.uniform(12.0, 30.0) * mass * GRAVITY / 4, friction=rng.uniform(0.55, 1.1),
    brush_share=rng.uniform(0.0, 0.2), relaxation=rng.uniform(0.1, 0.4) * radius,
    rolling_resistance=rng.uniform(0.01, 0.03), roll_front=rng.uniform(0.4, 0.6),
    imu_x=rng.uniform(-0.05, 0.05), imu_y=rng.uniform(-0.02, 0.02), drivetrain=train,
  )  # fmt: skip


def draw_wild_effects(seed: int, signed: frozenset[str]) -> tuple[tuple[str, float], ...]:
  """Four to eight effects of a session's seed, (id, size); `signed`: those that may be negative."""
  car, rng = draw_wild_car(np.random.default_rng([seed, 0])), np.random.default_rng([seed, 8])
  # commands of a duty are shares of one, so a zone of volts is scaled; the pack's sag is reckoned in volts
  duty = car.drivetrain.command == "duty"
  scale = {"drive_dead_zone": LIMIT["duty"] / LIMIT["voltage"]} if duty else {}
  while True:
    drawn = []
    for names, often, (least, most) in POOLS:
      names = tuple(name for name in names if not (duty and name == "battery_sag"))
      name, there, size = str(rng.choice(names)), rng.random() < often, float(rng.uniform(least, most))
      sign = float(rng.choice([-1.0, 1.0])) if name in signed else 1.0
      if there:
        drawn.append((name, sign * round(size * scale.get(name, 1.0), 3)))
    if FEWEST <= len(drawn) <= MOST:
      return tuple(drawn)


def draw_wild_sensors(rng: np.random.Generator) -> Sensors:
  """Lidar or motion capture; an encoder that speaks a hundred or ten times a second, and late."""
  tracked, slow = rng.random() < 0.5, rng.random() < 0.5
  return Sensors(
    pose_every=1 if tracked else 10,
    pose_noise=0.1 if tracked else 1.0,
    speed_every=10 if slow else 1,
    speed_late=rng.uniform(0.0, 0.1) if slow else 0.0,
  )


def known_of_it(
  vehicle: dict[str, float | str], std: dict[str, float]
) -> tuple[dict[str, float | str], dict[str, float]]:
  """What an owner knows of such a car: scale and ruler, nothing of motor and servo, a guess at the yaw inertia."""
  unknown = ("motor_constant", "motor_resistance", "servo_time_constant")
  kept = {name: value for name, value in vehicle.items() if name not in unknown}
  deviations = {name: value for name, value in std.items() if name not in unknown}
  return kept, deviations | {"yaw_inertia": 0.2 * float(vehicle["yaw_inertia"])}


def scaled(run: Manoeuvre, car: Car) -> Manoeuvre:
  """A manoeuvre as this car can drive it: speeds and distances by how fast it is, angles by its lock and its grip."""
  line, per_motor = car.linearised(), car.gear_ratio * car.wheel_radius
  limit = LIMIT[car.drivetrain.command]
  fastest = (line["P1"] * 0.9 * limit - line["P3"]) / line["P2"] * per_motor
  pace = fastest / USUAL_FASTEST
  speed, angle = CIRCLES
  lean = min(car.max_steering / Car().max_steering, STEEPEST * car.wheelbase / ((pace * speed) ** 2 * angle))
  usual = Car().linearised()
  turning = np.maximum(usual["P1"] * np.abs(run.volts) - usual["P3"], 0.0) / usual["P2"]
  wanted = pace * turning * Car().gear_ratio * Car().wheel_radius / per_motor
  command = np.sign(run.volts) * np.where(run.volts == 0.0, 0.0, (line["P2"] * wanted + line["P3"]) / line["P1"])
  x, y, yaw, begin = run.start
  return dataclasses.replace(
    run,
    steer=lean * run.steer,
    speed=pace * run.speed,
    volts=np.clip(command, -limit, limit),
    start=(pace * x, pace * y, yaw, pace * begin),
    path=None if run.path is None else _longer(run.path, pace),
  )


def _longer(path: Path, by: float) -> Path:
  """The same line, so many times as large."""
  arc = by * SPACING * np.arange(len(path.x))
  at = np.arange(0.0, arc[-1], SPACING)
  again = lambda values: np.interp(at, arc, values)
  return Path(by * again(path.x), by * again(path.y), again(path.yaw), again(path.curvature) / by)
