"""Reduced cars that are put to given motions every few periods."""

import numpy as np
import pytest

from qcar_twin.plant import MOTION, START, Segments, signal_index
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()
PERIODS, EVERY = 60, 10
COLUMNS = [signal_index(name) for name in MOTION]


def driving() -> Segments:
  time = 0.01 * np.arange(PERIODS)
  pairs = [(1.2 + 0.0 * time, 0.15 * np.sin(6.0 * time)), (np.where(time < 0.1, 0.0, 1.5), 0.1 + 0.0 * time)]
  commands = np.stack([np.stack(pair, axis=-1) for pair in pairs])
  return Segments(commands, np.zeros((2, len(START))), np.array([PERIODS, 47]), 0.01, ("a", "b"), np.zeros(2))


def own_motions(signals: np.ndarray) -> np.ndarray:
  """Motions of a free run where windows begin, (S, K, 7)."""
  return signals[:, 0:PERIODS:EVERY][..., COLUMNS]


@pytest.mark.parametrize("names", [(), ("steering_delay",), ("battery_sag",), ("motor_heating",)])
def test_windows_that_begin_where_a_free_run_is_are_that_run(names):
  twin = Twin(CAR, select(names), engine="reduced", threads=1)
  theta = twin.parameters.vector({p.name: p.typical for m in twin.mechanisms for p in m.parameters if p.typical})[None]
  free = twin.simulate(theta, driving())[0]
  windows = twin.simulate_windows(theta, driving(), own_motions(free), EVERY)[0]
  for k, steps in enumerate(driving().steps):
    assert np.allclose(windows[k, : steps + 1], free[k, : steps + 1], atol=1e-9)


def test_a_window_begins_where_it_is_put():
  twin = Twin(CAR, engine="reduced", threads=1)
  theta = twin.parameters.nominal[None]
  starts = own_motions(twin.simulate(theta, driving())[0])
  starts[:, 3, MOTION.index("pose_x")] += 1.0
  moved = twin.simulate_windows(theta, driving(), starts, EVERY)[0]
  free = twin.simulate(theta, driving())[0]
  x = moved[:, :, signal_index("pose_x")] - free[:, :, signal_index("pose_x")]
  assert np.allclose(x[0, 31:41], 1.0, atol=1e-9)
  assert np.allclose(x[0, 41:], 0.0, atol=1e-9)


def test_moved_starts_carry_what_the_first_vector_carries():
  """A push at the start of a window is gone with the next one."""
  twin = Twin(CAR, engine="reduced", threads=1)
  theta = np.repeat(twin.parameters.nominal[None], 2, axis=0)
  starts = own_motions(twin.simulate(theta[:1], driving())[0])
  shift = np.zeros((2, 7))
  shift[1, MOTION.index("pose_y")] = 0.5
  signals = twin.simulate_windows(theta, driving(), starts, EVERY, shift)
  change = signals[1] - signals[0]
  assert np.allclose(change[0, 1:, signal_index("pose_y")], 0.5, atol=1e-9)
  assert np.allclose(change[0, 1:, signal_index("yaw_rate")], 0.0, atol=1e-9)


def test_mujocos_cars_have_no_windows():
  twin = Twin(CAR, threads=1)
  with pytest.raises(TypeError, match="reduced"):
    twin.simulate_windows(twin.parameters.nominal[None], driving(), np.zeros((2, 6, 7)), EVERY)
