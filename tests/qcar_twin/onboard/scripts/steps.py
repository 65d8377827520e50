"""Open-loop steps of throttle and steering at 100 Hz: `steps.py [readMode] [seconds]`."""

import sys
import time

import numpy as np
from pal.products.qcar import QCar

mode = int(sys.argv[1]) if len(sys.argv) > 1 else 1
run_time = float(sys.argv[2]) if len(sys.argv) > 2 else 60.0
rate = 100
levels = [(0.06, 0.0), (0.10, 0.12), (0.14, -0.10), (0.0, 0.0), (0.12, 0.20), (0.17, 0.0), (0.08, -0.25), (-0.06, 0.0)]

log = []
with QCar(readMode=mode, frequency=rate) as car:
  t0 = time.time()
  while (t := time.time() - t0) < run_time:
    throttle, steering = levels[int(t / 1.5) % len(levels)] if t > 1.0 else (0.0, 0.0)
    car.read()
    car.write(throttle, steering, np.array([0, 0, 0, 0, 0, 0, 1, 1]))
    log.append((t, car.motorTach, car.gyroscope[2], car.accelerometer[1]))
    if mode == 0:
      time.sleep(max(0.0, t0 + len(log) / rate - time.time()))
log = np.array(log)
print(f"{len(log)} samples, {len(log) / log[-1, 0]:.1f} Hz, top speed {log[:, 1].max():.2f} m/s")
