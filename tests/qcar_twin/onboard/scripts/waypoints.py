"""Speed by PI and steering by Stanley's law along waypoints, with pose and filter: `waypoints.py [seconds] [m/s]`."""

import sys
import time

import numpy as np
from hal.content.qcar_functions import QCarEKF
from pal.products.qcar import QCar, QCarGPS
from pal.utilities.math import wrap_to_pi

run_time = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
v_ref = float(sys.argv[2]) if len(sys.argv) > 2 else 0.9
angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
waypoints = np.stack([1.6 * np.sin(angle), 1.1 * np.sin(angle) * np.cos(angle)])  # a figure of eight, m
start = [*waypoints[:, 0], np.arctan2(1.1, 1.6)]


class Speed:
  """PI on the tachometer."""

  def __init__(self):
    self.integral = 0.0

  def update(self, v, target, dt):
    error = target - v
    self.integral = np.clip(self.integral + dt * error, -0.5, 0.5)
    return np.clip(0.10 * target + 0.12 * error + 0.20 * self.integral, 0.0, 0.25)


class Stanley:
  """Heading of the path's nearest piece plus what brings the front axle back to it."""

  def __init__(self, points, gain=1.2):
    self.points, self.gain, self.nearest = points, gain, 0

  def update(self, x, y, yaw, v):
    front = np.array([x + 0.128 * np.cos(yaw), y + 0.128 * np.sin(yaw)])
    window = (self.nearest + np.arange(-3, 30)) % self.points.shape[1]
    gaps = self.points[:, window] - front[:, None]
    self.nearest = int(window[np.argmin(np.hypot(*gaps))])
    here, there = self.points[:, self.nearest], self.points[:, (self.nearest + 1) % self.points.shape[1]]
    heading = np.arctan2(*(there - here)[::-1])
    aside = np.cos(heading) * (front - here)[1] - np.sin(heading) * (front - here)[0]
    error = np.hypot(*gaps).min()
    return np.clip(wrap_to_pi(heading - yaw) - np.arctan2(self.gain * aside, v + 0.1), -0.5, 0.5), error


speed, stanley, ekf, delta, errors = Speed(), Stanley(waypoints), QCarEKF(start), 0.0, []
with QCar(readMode=1, frequency=100) as car, QCarGPS(initialPose=start) as gps:
  t0 = last = time.perf_counter()
  while time.perf_counter() - t0 < run_time:
    car.read()
    now = time.perf_counter()
    dt, last = now - last, now
    pose = np.array([gps.position[0], gps.position[1], gps.orientation[2]]) if gps.readGPS() else None
    ekf.update([car.motorTach, delta], dt, pose, car.gyroscope[2])
    x, y, yaw = ekf.x_hat[:, 0]
    delta, error = stanley.update(x, y, yaw, car.motorTach)
    driving = now - t0 > 1.0
    car.write(speed.update(car.motorTach, v_ref, dt) if driving else 0.0, delta if driving else 0.0)
    errors.append(error)
print(f"{len(errors)} samples, cross-track error {1e3 * np.sqrt(np.mean(np.square(errors))):.1f} mm")
