"""A car that obeys the filter's own model, and sensors that obey its noise."""

import dataclasses
import math

import numpy as np

from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.estimation import models
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.settings import FilterSettings

CAR = SingleTrackCar(4800.0, 8.0, 1600.0, 150.0, 210.0, 2.7, 0.030, 0.120, 0.136, 0.0953668 * 0.033)
PERIOD = 0.01


def hold(speed):
  """Voltage that keeps a speed."""
  friction = math.copysign(CAR.drive_friction, speed) if speed else 0.0
  return (CAR.drive_damping * speed / CAR.rolling_radius + friction) / CAR.drive_gain


@dataclasses.dataclass
class Journey:
  """One simulated drive: truth at every period and what the sensors said; NaN for no sample."""

  time: np.ndarray  # (T,)
  truth: np.ndarray  # X, Y, v, psi, beta, r, (T, 6)
  commands: np.ndarray  # (T, 2)
  speed: np.ndarray  # (T,)
  yaw_rate: np.ndarray  # (T,)
  accel: np.ndarray  # (T, 2)
  fix: np.ndarray  # x, y, yaw, score, (T, 4)


def journey(seconds=20.0, speed=0.5, seed=0, amplitude=0.25, settings=None, commands=None):
  """A weaving drive with white noise of the stated sizes, lidar every tenth period."""
  settings = settings or FilterSettings()
  rng = np.random.default_rng(seed)
  count = round(seconds / PERIOD)
  time = PERIOD * np.arange(count)
  if commands is None:
    commands = np.stack([np.full(count, hold(speed)), amplitude * np.sin(0.9 * time)], axis=1)
  truth = np.empty((count, 6))
  state = (0.0, 0.0, speed, 0.2, 0.0, 0.0)
  accel = np.empty((count, 2))
  for k in range(count):
    truth[k] = state
    accel[k] = 0.0, models.lateral_acceleration(state, commands[k, 1], CAR)[0]
    state, _ = models.bicycle_step(state, *commands[k], CAR, PERIOD)
  position, yaw = (math.sqrt(v) for v in settings.pose_noise(settings.score))
  fix = truth[:, [0, 1, 3, 3]] + rng.normal(size=(count, 4)) * (position, position, yaw, 0.0)
  fix[:, 3] = settings.score
  fix[np.arange(count) % 10 != 0] = np.nan
  measured = truth[:, 2] + settings.speed_std * rng.normal(size=count)
  turning = truth[:, 5] + settings.yaw_rate_std * rng.normal(size=count)
  return Journey(time, truth, commands, measured, turning, accel + 0.1 * rng.normal(size=(count, 2)), fix)


def run(journey, settings=None, latency=0, federated=None, order=None):
  """Drive the online filter; returns the estimates and the filter."""
  federated = federated or FederatedFilter(CAR, settings)
  estimates, waiting = [], []
  for k, time in enumerate(journey.time):
    said = {
      "speed": journey.speed[k],
      "yaw_rate": journey.yaw_rate[k],
      "accel_x": journey.accel[k, 0],
      "accel_y": journey.accel[k, 1],
    }
    for name, value in said.items():
      if math.isfinite(value):
        federated.update(time, name, value)
    waiting.append((time, journey.fix[k]))
    if len(waiting) > latency:
      stamp, fix = waiting.pop(0)
      for name, value in zip(("pose_x", "pose_y", "pose_yaw", "pose_score"), fix, strict=True):
        if math.isfinite(value):
          federated.update(stamp, name, value)
    estimates.append(federated.estimate(time))
    federated.update(time, "motor_voltage", journey.commands[k, 0])
    federated.update(time, "steering_command", journey.commands[k, 1])
  return estimates, federated


def position_errors(journey, estimates):
  """Distance between the master's and the true position, m, (T,)."""
  return np.array([math.hypot(e.pose_x - t[0], e.pose_y - t[1]) for e, t in zip(estimates, journey.truth, strict=True)])


def rms(values):
  return float(np.sqrt(np.mean(np.square(values))))
