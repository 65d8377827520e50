"""Concealed effects of the second car: each sets numbers of the car that are null without it.

Names, parameters and their meaning are the catalogue's (docs/reference/mechanisms.md), formulas the car's own;
`typical` is what size 1 means, the same as for the first car. A parameter that means the same in both carries the
catalogue's name.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .car import NOMINAL_PACK, SecondCar

DEGREE = np.pi / 180
STALL = 2.5  # V at which the sag of a battery is stated
QUICK = 0.6  # of a sag that comes at once, the rest after PACK_TIME
PACK_TIME = 1.2  # s
DECK = 0.03  # m, a payload's height above the centre of gravity

Change = Callable[[SecondCar, float, np.random.Generator], tuple[SecondCar, dict[str, float]]]


@dataclass(frozen=True)
class SecondEffect:
  """One kind. `change`: car, magnitude and what may be drawn -> the changed car and what the truth says of it."""

  id: str
  subsystem: str
  typical: float
  unit: str
  change: Change
  signed: bool = False


def _sets(field: str, parameter: str, offset: float = 0.0) -> Change:
  """A number of the car that becomes the magnitude itself, on top of an offset."""
  return lambda car, value, _rng: (replace(car, **{field: offset + value}), {parameter: value})


def _adds(field: str, parameter: str) -> Change:
  """A number of the car that grows by the magnitude."""
  return lambda car, value, _rng: (replace(car, **{field: getattr(car, field) + value}), {parameter: value})


def _sag(car: SecondCar, value: float, _rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """V = V_0 / (1 + R D^2 / R_m) on a standing motor, which is to be V_0 / (1 + s) at a command of 2.5 V."""
  whole = value * car.motor_resistance * (NOMINAL_PACK / STALL) ** 2
  quick, slow = car.pack_resistance + QUICK * whole, car.pack_slow_resistance + (1 - QUICK) * whole
  return replace(car, pack_resistance=quick, pack_slow_resistance=slow, pack_time=PACK_TIME), {"battery_sag": value}


def _stiction(car: SecondCar, value: float, _rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """A force at the wheels, as a torque at the gears' output."""
  return replace(car, breakaway=value * car.wheel_radius), {"stiction_force": value}


def _backward(car: SecondCar, value: float, _rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """Negative voltages arrive stronger by a share."""
  return replace(car, drive_backward=1.0 + value), {"drive_asymmetry": value}


def _clutch(car: SecondCar, value: float, _rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """Preloaded clutches in either axle, each wheel held by half of the torque between left and right."""
  return replace(car, clutch=value), {"differential_preload": 0.5 * value}


def _wheels(car: SecondCar, value: float, _rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """Larger wheels than the ruler said; the car stands higher by as much."""
  more = value * car.wheel_radius
  driven = replace(car, wheel_radius=car.wheel_radius + more, cg_height=car.cg_height + more)
  return driven, {"wheel_radius_error": value}


def _box(car: SecondCar, value: float, rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """A box on the deck, anywhere between the axles' inner halves; what is bolted to the chassis stays there."""
  ahead = float(rng.uniform(-0.04, 0.04))
  mass = car.mass + value
  shift, lift, joint = ahead * value / mass, DECK * value / mass, car.mass * value / mass
  own = value * 0.03**2  # kg m^2 of the box itself, about any axis
  loaded = replace(
    car, mass=mass, cg_to_front=car.cg_to_front - shift, cg_to_rear=car.cg_to_rear + shift,
    cg_height=car.cg_height + lift, imu_x=car.imu_x - shift, marker_x=car.marker_x - shift,
    roll_inertia=car.roll_inertia + own + joint * DECK**2,
    pitch_inertia=car.pitch_inertia + own + joint * (DECK**2 + ahead**2),
    yaw_inertia=car.yaw_inertia + own + joint * ahead**2,
  )  # fmt: skip
  return loaded, {"payload_mass": value, "payload_x": ahead}


def _aside(car: SecondCar, value: float, _rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """The battery lies to one side; IMU and tracked point stay where they are on the chassis."""
  moved = replace(car, cg_lateral=value, imu_y=car.imu_y - value, marker_y=car.marker_y - value)
  return moved, {"cg_lateral_offset": value}


def _slope(car: SecondCar, value: float, rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """The floor leans in a direction drawn at random."""
  heading = rng.uniform(-np.pi, np.pi)
  x, y = float(value * np.cos(heading)), float(value * np.sin(heading))
  return replace(car, slope_x=x, slope_y=y), {"floor_slope_x": x, "floor_slope_y": y}


def _oil(car: SecondCar, value: float, rng: np.random.Generator) -> tuple[SecondCar, dict[str, float]]:
  """A slippery disc near the middle of the room."""
  x, y, radius = rng.uniform(-0.8, 0.8), rng.uniform(0.0, 1.6), rng.uniform(0.7, 1.1)
  place = {"friction_patch_x": x, "friction_patch_y": y, "friction_patch_radius": radius}
  return replace(car, patch_loss=value, patch_x=x, patch_y=y, patch_radius=radius), {"friction_patch": value} | place


_KINDS = (
  SecondEffect("steering_delay", "steering", 0.040, "s", _sets("steering_delay", "steering_delay")),
  SecondEffect("steering_lag", "steering", 0.055, "s", _adds("servo_time", "steering_lag")),
  SecondEffect("steering_offset", "steering", 2 * DEGREE, "rad", _sets("steering_trim", "steering_offset"), True),
  SecondEffect("steering_gain_error", "steering", 0.08, "-", _sets("steering_gain", "steering_gain_error", 1.0), True),
  SecondEffect("steering_backlash", "steering", 1.5 * DEGREE, "rad", _sets("steering_play", "steering_play")),
  SecondEffect("steering_dead_zone", "steering", 1.5 * DEGREE, "rad", _sets("steering_zone", "steering_dead_zone")),
  SecondEffect("drive_dead_zone", "drive", 0.15, "V", _sets("drive_zone", "drive_dead_zone")),
  SecondEffect("drive_delay", "drive", 0.035, "s", _sets("drive_delay", "drive_delay")),
  SecondEffect("drive_lag", "drive", 0.10, "s", _sets("drive_time", "drive_lag")),
  SecondEffect("drive_asymmetry", "drive", 0.10, "-", _backward, True),
  SecondEffect("battery_sag", "drive", 0.30, "-", _sag),
  SecondEffect("quadratic_drag", "drive", 0.40, "kg/m", _adds("drag", "quadratic_drag")),
  SecondEffect("stiction", "drive", 0.7, "N", _stiction),
  SecondEffect("differential_lock", "drive", 0.04, "N m", _clutch),
  SecondEffect("wheel_radius_error", "tyre", 0.04, "-", _wheels, True),
  SecondEffect("tyre_relaxation", "tyre", 0.07, "m", _sets("relaxation_front", "tyre_relaxation")),
  SecondEffect("friction_patch", "tyre", 0.40, "-", _oil),
  SecondEffect("side_force", "tyre", 0.7, "N", _sets("conicity", "side_force"), True),
  SecondEffect("floor_slope", "ground", 0.20, "m/s^2", _slope),
  SecondEffect("payload", "body", 0.55, "kg", _box),
  SecondEffect("cg_lateral_offset", "body", 0.014, "m", _aside, True),
  SecondEffect("gyro_scale", "sensor", 0.05, "-", _sets("gyro_gain", "gyro_scale"), True),
  SecondEffect("imu_misalignment", "sensor", 5 * DEGREE, "rad", _sets("imu_twist", "imu_misalignment"), True),
  SecondEffect("imu_latency", "sensor", 0.055, "s", _sets("imu_delay", "imu_latency")),
)
SECOND_EFFECTS: dict[str, SecondEffect] = {kind.id: kind for kind in _KINDS}
SIZES = (0.85, 1.25)  # of typical, of what is drawn


def second_effect(name: str, size: float) -> SecondEffect:
  """The effect of an id. Raises KeyError for one that the second car does not have, ValueError for a wrong sign."""
  if name not in SECOND_EFFECTS:
    near = difflib.get_close_matches(name, SECOND_EFFECTS, n=1)
    valid = f"did you mean '{near[0]}'?" if near else f"valid are: {', '.join(sorted(SECOND_EFFECTS))}"
    raise KeyError(f"the second car has no effect '{name}'; {valid}")
  kind = SECOND_EFFECTS[name]
  if size < 0.0 and not kind.signed:
    raise ValueError(f"effect '{name}' has no negative size, got {size:g}")
  return kind


def draw_size(name: str, rng: np.random.Generator) -> float:
  """About the typical size, of either sign where the effect has one."""
  sign = float(rng.choice([-1.0, 1.0])) if SECOND_EFFECTS[name].signed else 1.0
  return sign * round(float(rng.uniform(*SIZES)), 3)


def draw_second_effect(rng: np.random.Generator) -> tuple[str, float]:
  """One effect and its size."""
  name = str(rng.choice(sorted(SECOND_EFFECTS)))
  return name, draw_size(name, rng)


def conceal(
  car: SecondCar, effects: tuple[tuple[str, float], ...], rng: np.random.Generator
) -> tuple[SecondCar, list[dict]]:
  """The car with effects (id, size in multiples of the typical one), and what the truth says of each."""
  stated = []
  for name, size in effects:
    kind = second_effect(name, size)
    car, parameters = kind.change(car, kind.typical * size, rng)
    stated.append(
      {"id": name, "size": float(size), "subsystem": kind.subsystem, "in_catalogue": True, "unit": kind.unit,
       "parameters": {key: float(value) for key, value in parameters.items()}}
    )  # fmt: skip
  return car, stated
