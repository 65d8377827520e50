"""Numbers of a semi-implicit step read at one time err by the square of the step."""

import numpy as np
import pytest

from qcar_twin.plant import SIGNALS
from qcar_twin.twin.reading import at_one_time, in_pieces, rows_of

PERIOD, SPEED, RATE = 0.01, 2.0, 8.0  # s; m/s, rad/s of a body that swings along x while it turns to and fro


def swinging(step: float, read: bool) -> np.ndarray:
  """Largest error of x, yaw and accel_x of a body with speed SPEED cos(RATE t) and yaw rate sin(RATE t)."""
  count, per = 200, round(PERIOD / step)
  signals = np.zeros((1, count + 1, len(SIGNALS)))
  column = {name: signals[0, :, SIGNALS.index(name)] for name in SIGNALS}
  times = step * np.arange(count * per + 1)
  speed, turn = SPEED * np.cos(RATE * times), np.sin(RATE * times)
  column["velocity_x"][:], column["yaw_rate"][:] = speed[::per], turn[::per]
  yaw = np.concatenate([[0.0], np.cumsum(step * turn[1:])])
  column["pose_yaw"][:] = yaw[::per]
  # along the heading at velocities' time: that of the path is not what is asked here
  heading = (1.0 - np.cos(RATE * times)) / RATE
  column["pose_x"][:] = np.concatenate([[0.0], np.cumsum(step * (speed * np.cos(heading))[1:])])[::per]
  column["accel_x"][1:] = (np.diff(speed) / step)[per - 1 :: per]
  shown = at_one_time(signals, step, PERIOD)[0] if read else signals[0]
  fine = np.linspace(0.0, PERIOD * count, 200 * count + 1)
  path = SPEED * np.cos(RATE * fine) * np.cos((1.0 - np.cos(RATE * fine)) / RATE)
  x = np.concatenate([[0.0], np.cumsum(0.5 * (path[1:] + path[:-1]) * (fine[1] - fine[0]))])[::200]
  time = times[::per]
  right = {"pose_x": x, "pose_yaw": (1.0 - np.cos(RATE * time)) / RATE, "accel_x": -SPEED * RATE * np.sin(RATE * time)}
  inner = slice(1, -1)  # the first acceleration is the start's, the last has no reading after it
  return np.array([np.abs(shown[inner, SIGNALS.index(n)] - right[n][inner]).max() for n in right])


def test_positions_and_accelerations_are_those_of_the_velocities_time():
  raw, read = swinging(0.005, read=False), swinging(0.005, read=True)
  assert np.all(read < 0.15 * raw)
  assert raw[0] == pytest.approx(0.5 * 0.005 * 2.0 * SPEED, rel=0.3)  # half a step of the change of speed


def test_half_the_step_leaves_a_quarter_of_a_positions_error():
  assert np.all(swinging(0.0025, read=True)[:2] < 0.3 * swinging(0.005, read=True)[:2])


@pytest.mark.parametrize("rows", [1, 7, 500])
def test_signals_in_pieces_are_the_same(rows):
  signals = np.random.default_rng(0).normal(size=(rows, 40, 10))
  shown = in_pieces(signals)
  assert np.array_equal(shown, signals) and all(shown[..., k].flags.c_contiguous for k in range(10))
  twice = rows_of(shown, np.repeat(np.arange(rows), 2))
  assert np.array_equal(twice[1::2], signals) and all(twice[..., k].flags.c_contiguous for k in range(10))
