"""A thread that controls, one that logs, each with a timing of its own: `threads.py [seconds]`."""

import queue
import sys
import threading
import time

import numpy as np
from pal.products.qcar import QCar

run_time = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
stop, lock, rows = threading.Event(), threading.Lock(), queue.Queue()
state = {"speed": 0.0, "turning": 0.0}
car = QCar(readMode=0)


def control():
  """At 50 Hz: a speed that rises and falls, a weave whose frequency rises."""
  begun, k = time.monotonic(), 0
  while not stop.is_set():
    t = time.monotonic() - begun
    car.read()
    with lock:
      state.update(speed=car.motorTach, turning=car.gyroscope[2])
    target = 0.9 + 0.5 * np.sin(0.45 * t)
    throttle = 0.11 * target + 0.15 * (target - car.motorTach) if t > 1.0 else 0.0
    car.write(np.clip(throttle, 0.0, 0.25), 0.22 * np.sin(t * (0.8 + 0.03 * t)) if t > 1.0 else 0.0)
    k += 1
    time.sleep(max(0.0, begun + k * 0.02 - time.monotonic()))


def log():
  """At 20 Hz, from what the other thread shares."""
  while not stop.wait(0.05):
    with lock:
      rows.put((time.time(), state["speed"], state["turning"]))


threads = [threading.Thread(target=control), threading.Thread(target=log)]
for thread in threads:
  thread.start()
time.sleep(run_time)
stop.set()
for thread in threads:
  thread.join()
car.terminate()
kept = np.array([rows.get() for _ in range(rows.qsize())])
print(f"{len(kept)} rows, mean speed {kept[:, 1].mean():.2f} m/s, fastest turn {np.abs(kept[:, 2]).max():.2f} rad/s")
