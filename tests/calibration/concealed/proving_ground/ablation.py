"""How much each of the generator's benign differences from a textbook car changes what is logged."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from calibration.concealed.laboratory.written import Session
from calibration.concealed.proving_ground.car import GRAVITY, Car
from calibration.concealed.proving_ground.session import Spec, make_sessions

NOISE = {
  "motor_speed": 0.55,
  "accel_x": 0.06,
  "accel_y": 0.06,
  "yaw_rate": 0.006,
  "pose_yaw": 0.005,
}  # rms of the sensors


def _without_rolling_resistance(car: Car) -> dict[str, float]:
  """The same P3, all of it in the motor's dry friction."""
  torque = car.gear_ratio * car.wheel_radius * car.rolling_resistance * car.mass * GRAVITY
  return {"rolling_resistance": 0.0, "motor_coulomb": car.motor_coulomb + torque}


ABLATIONS: dict[str, Callable[[Car], dict[str, float]]] = {
  "transient slip of the carcass": lambda car: {"relaxation": 0.004},
  "servo, equivalent delay": lambda car: {"servo_rate": 4 * car.servo_rate},
  "Ackermann share": lambda car: {"ackermann": 1.0},
  "rolling resistance at the wheels": _without_rolling_resistance,
  "body roll and pitch": lambda car: {"roll_rate": 300.0, "pitch_rate": 300.0},
  "share of the brush in the tyre law": lambda car: {"brush_share": 0.0},
  "tyre load curve": lambda car: {"load_curve": 0.0, "friction_load": 0.0},
  "armature warms": lambda car: {"copper": 0.0},
  "pack voltage falls over the whole charge": lambda car: {"discharge": 0.0},
  "dry friction builds up over a motor angle": lambda car: {"presliding": 0.05},
}


def ablate(seed: int = 0, design: str = "compact") -> dict[str, dict[str, float]]:
  """Gap -> channel -> rms change of the log when the gap is closed, before any refit, over the sensor's own noise."""
  car = Car.draw(np.random.default_rng([seed, 0]))
  specs = [Spec(seed, (), design, 0.0, dataclasses.replace(car, **change(car))) for change in ABLATIONS.values()]
  base, *others = make_sessions([Spec(seed, (), design, 0.0, car), *specs])
  return {gap: _changes(base, other) for gap, other in zip(ABLATIONS, others, strict=True)}


def _changes(base: Session, other: Session) -> dict[str, float]:
  """Channel -> rms difference between two sessions in units of NOISE."""

  def rms(channel: str) -> float:
    pairs = zip(base.recordings, other.recordings, strict=True)
    return float(np.sqrt(np.mean(np.concatenate([a[channel].value - b[channel].value for a, b in pairs]) ** 2)))

  return {channel: rms(channel) / noise for channel, noise in NOISE.items()}
