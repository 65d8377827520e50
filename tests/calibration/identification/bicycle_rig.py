"""Recordings that the bicycle model itself made, for tests of what identifies it."""

from types import SimpleNamespace

import numpy as np

from qcar_twin.bicycle.bicycle import PARAMETERS, Bicycle, TurningLosses
from qcar_twin.plant import SIGNALS, START, Segments
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording

PERIOD = 0.01
NUMBERS = {
  "mass": 2.7, "yaw_inertia": 0.030, "cg_to_front": 0.124, "cg_to_rear": 0.132, "wheel_radius": 0.033,
  "gear_ratio": 0.0953668, "max_steering": 0.5236, "imu_x": 0.02, "imu_y": -0.01, "track_width": 0.17,
  "cg_height": 0.045,
}  # fmt: skip
VEHICLE = SimpleNamespace(**NUMBERS)
ROLLING = VEHICLE.gear_ratio * VEHICLE.wheel_radius
EXACT_STD = {name: 1e-9 for name in NUMBERS}
THETA = PARAMETERS.vector(
  {
    "drive_gain": 620.0,
    "drive_damping": 1.8,
    "drive_friction": 115.0,
    "cornering_stiffness_front": 140.0,
    "cornering_stiffness_rear": 165.0,
  }
)
VOLTS = {"identify": (0.75, 1.25, 1.5, 2.0, 2.5), "validate": (1.1, 1.85)}
DEGREES = {"identify": (4.0, 7.0, 9.0, 11.0, 14.0), "validate": (5.5, 12.5)}
PLAIN = TurningLosses()
NOISE = {"motor_speed": 0.6, "yaw_rate": 0.006, "accel_x": 0.06, "accel_y": 0.06}


def drive(runs, noise=0.0, seed=0, channels=tuple(NOISE), theta=THETA, vehicle=VEHICLE, losses=PLAIN):
  """Recordings of (name, role, manoeuvre, commands (T, 2), start (7,)) with equal T, driven side by side.

  Row k of a recording is what is measured just before command k acts.
  """
  names, roles, manoeuvres, commands, start = zip(*runs, strict=True)
  length, signals = len(commands[0]), _clean(np.stack(commands), np.stack(start), theta, vehicle, losses)
  rng, made = np.random.default_rng(seed), []
  for name, role, manoeuvre, u, rows in zip(names, roles, manoeuvres, commands, signals, strict=True):
    columns = {"motor_voltage": u[:, 0], "steering_command": u[:, 1]}
    for channel in channels:
      values = rows[:, SIGNALS.index("motor_speed" if channel == "speed" else channel)]
      values = values * (ROLLING if channel == "speed" else 1.0)
      columns[channel] = values + noise * rng.standard_normal(length) * NOISE.get(channel, 0.002)
    time = PERIOD * np.arange(length)
    made.append(Recording.from_columns(name, time, columns, role=role, manoeuvre=manoeuvre, file=f"{name}.csv"))
  return made


_made = {}


def _clean(commands, start, theta, vehicle, losses):
  """Signals (S, T, 10), kept: many tests differ only in the noise on top."""
  key = commands.tobytes(), start.tobytes(), theta.tobytes(), repr(vehicle), losses
  if key not in _made:
    count, length = commands.shape[:2]
    segments = Segments(commands, start, np.full(count, length), PERIOD, ("run",) * count, np.zeros(count))
    _made[key] = Bicycle(vehicle, losses=losses).rollout(theta, segments).signals[0, :, :-1]
  return _made[key]


def voltage_steps(levels=VOLTS, duration=5.5, **kwargs):
  """From rest, a step after half a second."""
  runs = []
  for role, volts in _pairs(levels):
    commands = np.zeros((round(duration / PERIOD), 2))
    commands[50:, 0] = volts
    runs.append((f"voltage_step_{volts:g}V", role, "voltage_step", commands, np.zeros(len(START))))
  return drive(runs, **kwargs)


def steering_steps(levels=DEGREES, duration=4.0, speed=1.5, **kwargs):
  """A step after a second of straight running, at the voltage that holds the speed."""
  theta, runs = kwargs.get("theta", THETA), []
  for role, degrees in _pairs(levels):
    commands = np.zeros((round(duration / PERIOD), 2))
    commands[:, 0] = (theta[1] * speed / ROLLING + theta[2]) / theta[0]
    commands[100:, 1] = np.deg2rad(degrees)
    start = np.zeros(len(START))
    start[START.index("velocity_x")] = speed
    runs.append((f"steering_step_{degrees:g}deg", role, "steering_step", commands, start))
  return drive(runs, **kwargs)


def _pairs(levels):
  return [(role, value) for role, values in levels.items() for value in values]


def session(**kwargs):
  """Voltage steps and step steers of the paper."""
  return DataSet("made", (*voltage_steps(**kwargs), *steering_steps(**kwargs)), NUMBERS, EXACT_STD)
