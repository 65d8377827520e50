"""Stopping MuJoCo's profiling clock changes its timers and nothing else."""

import mujoco
import numpy as np

from qcar_twin.twin.timers import stop_timers, timers_stopped
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import Vehicle


def driven() -> mujoco.MjData:
  model = car_spec(Vehicle.load()).compile()
  data = mujoco.MjData(model)
  data.ctrl[:] = 2.0, 0.2
  mujoco.mj_step(model, data, 200)
  return data


def test_the_clock_stops_and_the_car_does_not():
  with timers_stopped():
    mujoco.set_mjcb_time(None)  # the package's own clock
    timed = driven()
    assert stop_timers()
    untimed = driven()
    mujoco.set_mjcb_time(None)
    again = driven()
  step = mujoco.mjtTimer.mjTIMER_STEP
  assert timed.timer[step].duration > 0.0 and again.timer[step].duration > 0.0
  assert untimed.timer[step].duration == 0.0
  np.testing.assert_array_equal(timed.qpos, untimed.qpos)


def test_without_the_library_it_only_says_so(monkeypatch, tmp_path):
  monkeypatch.setattr(mujoco, "__file__", str(tmp_path / "__init__.py"))
  assert not stop_timers()
  with timers_stopped():
    pass
