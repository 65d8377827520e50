"""From the command to the wheels: battery, bridge, motor with inductance, gears that rub, three differentials.

Motor: L i' = V - R i - K w. Battery: Thevenin's, V_p = V_0 - R_0 D i - V_1, V_1' = (R_1 D i - V_1) / T, D = u / V_0
(Chen and Rincon-Mora, IEEE Trans. Energy Conversion 21(2), 2006). Gears: LuGre friction with a Stribeck curve (Canudas
de Wit, Olsson, Astrom and Lischinsky, IEEE TAC 40(3), 1995) at their output. One spring stands for all shafts; a
differential in the centre and one in either axle share its torque evenly, but for their grease.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from .car import NOMINAL_PACK
from .states import State

SLEW = 60.0  # V/s, fastest that a smoothed reference moves
KNEE = 0.08  # of the dead zone: width of its corner
RUB_DAMPING = 0.012  # N m s/rad of the gears' bristles, fading over RUB_FADE
RUB_FADE = 1.0  # rad/s


def swallowed(value: np.ndarray, zone: np.ndarray) -> np.ndarray:
  """A signal after a dead zone of half-width `zone`, its corners hyperbolas; nothing is changed where zone is 0."""
  if not zone.any():
    return value
  over = np.abs(value) - zone
  soft = KNEE * zone
  kept = 0.5 * (over + np.sqrt(over * over + soft * soft)) - 0.5 * (np.sqrt(zone * zone + soft * soft) - zone)
  return np.sign(value) * kept


def reference_rate(car: SimpleNamespace, state: State, wanted: np.ndarray) -> np.ndarray:
  """Rate of the bridge's smoothed reference [V/s]."""
  if not car.drive_time.any():
    return np.zeros_like(wanted)
  pull = (wanted - state.reference) / np.where(car.drive_time > 0.0, car.drive_time, 1.0)
  return np.where(car.drive_time > 0.0, pull / np.sqrt(1.0 + (pull / SLEW) ** 2), 0.0)


def bridge(car: SimpleNamespace, state: State, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
  """Voltage at the motor [V] and current from the pack [A]."""
  volts = swallowed(np.where(car.drive_time > 0.0, state.reference, wanted), car.drive_zone)
  duty = np.where(volts < 0.0, car.drive_backward, 1.0) * volts / NOMINAL_PACK
  drawn = duty * state.current
  return duty * (NOMINAL_PACK - car.pack_resistance * drawn - state.polarisation), drawn


def drive_rates(car: SimpleNamespace, state: State, rate: State, wanted: np.ndarray) -> np.ndarray:
  """Fill the drive's rates; returns the torques of the half shafts on the wheels (4, n) [N m]."""
  volts, drawn = bridge(car, state, wanted)
  rate.reference[:] = reference_rate(car, state, wanted)
  rate.polarisation[:] = (car.pack_slow_resistance * drawn - state.polarisation) / car.pack_time
  back = car.motor_constant * state.motor
  rate.current[:] = (volts - car.motor_resistance * car.warm * state.current - back) / car.motor_inductance
  output, wheel = car.gear_ratio * state.motor, state.wheel
  rate.twist[:] = output - 0.25 * wheel.sum(axis=0)
  torque = car.shaft_stiffness * state.twist + car.shaft_damping * rate.twist
  hold = car.gear_friction + car.breakaway * np.exp(-((output / car.breakaway_speed) ** 2))
  stiff = car.gear_friction / car.gear_presliding
  rate.rub[:] = output - stiff * np.abs(output) / hold * state.rub
  rubbing = stiff * state.rub + RUB_DAMPING / (1.0 + (output / RUB_FADE) ** 2) * rate.rub
  own = car.motor_constant * state.current - car.motor_viscous * state.motor
  rate.motor[:] = (own - car.gear_ratio * (torque + rubbing)) / car.motor_inertia
  rate.motor_angle[:] = state.motor
  return 0.25 * torque + _differentials(car, wheel)


def _differentials(car: SimpleNamespace, wheel: np.ndarray) -> np.ndarray:
  """What grease and clutches carry from faster to slower wheels (4, n) [N m]."""
  apart = wheel[0::2] - wheel[1::2]
  pair = 0.5 * car.grease_axle * apart + 0.5 * car.clutch * apart / np.sqrt(apart * apart + 0.25)
  centre = 0.25 * car.grease_centre * 0.5 * (wheel[0] + wheel[1] - wheel[2] - wheel[3])
  return np.stack([-pair[0] - centre, pair[0] - centre, -pair[1] + centre, pair[1] + centre])
