"""What was commanded before a stretch is on its way when it begins."""

import numpy as np
import pytest

from calibration.fitting.windows import Cut, cut_recordings
from qcar_twin.plant import SIGNALS, START
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.twin.mechanisms import catalogue, select
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.twin.mechanisms.elements import delay_line, delay_step, held_back
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

PERIOD, BEGUN, KNOWN = 0.01, 90, 30


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.05])
def test_a_delay_hands_out_what_was_told_before_it_began(delay):
  time = PERIOD * np.arange(60)
  command = np.sin(9.0 * time)[None]
  line = delay_line(np.array([delay]), PERIOD, 0.2, command[:, 30], np.zeros(1), command[:, :30])
  handed = np.array([delay_step(line, command[:, k])[0] for k in range(30, 60)])
  np.testing.assert_allclose(handed, held_back(command, np.array([delay]), PERIOD)[0, 30:], atol=1e-12)


def test_before_a_recording_nobody_knows_what_was_told():
  past = np.array([[np.nan, np.nan, 1.0, 2.0]])
  np.testing.assert_array_equal(held_back(past, np.array([0.015]), PERIOD), [[np.nan] * 4])
  np.testing.assert_array_equal(held_back(past, np.array([0.01]), PERIOD), [[np.nan, np.nan, np.nan, 1.0]])
  line = delay_line(np.array([0.03]), PERIOD, 0.05, np.array([3.0]), np.array([3.0]), past)["line"][0]
  np.testing.assert_array_equal(line[:4], [2.0, 1.0, 3.0, 3.0])  # the newest first; as if it had always stood


def test_no_mechanism_holds_commands_back_for_longer_than_they_are_known():
  holding = [m for m in catalogue().values() if type(m).past is not Mechanism.past]
  assert {m.name for m in holding} == {"command_delay", "drive_delay", "steering_delay"}
  assert max(p.upper for m in holding for p in m.parameters) == pytest.approx(KNOWN * PERIOD)


@pytest.mark.parametrize(
  "delays",
  [
    {"command_delay": 0.074},
    {"drive_delay": 0.05, "steering_delay": 0.03},
    {"command_delay": 0.05, "drive_delay": 0.03, "steering_delay": 0.02},
  ],
)
def test_a_car_that_begins_in_mid_drive_goes_on_as_the_one_that_drove(delays):
  """Without it the new car has the first command at once, and its motor is off by seven times as much and more."""
  twin = Twin(
    QCAR,
    select([name for name in ("command_delay", "drive_delay", "steering_delay") if name in delays]),
    threads=1,
    engine="reduced",
  )
  theta = twin.parameters.vector(twin.parameters.named(twin.parameters.nominal) | delays)[None]
  levels = np.random.default_rng(3).uniform([0.8, -0.2], [2.5, 0.2], (40, 2))
  commands = np.repeat(levels, 4, axis=0)  # another one every 40 ms
  cars = twin.begin(theta, np.zeros((1, 7)))
  whole = np.concatenate([cars.step(c[None]).copy() for c in commands])
  now = whole[BEGUN - 1]
  start = np.array([[now[SIGNALS.index(name)] for name in START]])
  rim = np.array([now[SIGNALS.index("motor_speed")] * QCAR.gear_ratio * QCAR.wheel_radius])

  def off(first: np.ndarray) -> tuple[float, float]:
    again = twin.begin(theta, start, first_command=first[None], rim_speed=rim)
    motion = np.concatenate([again.step(c[None]).copy() for c in commands[BEGUN : BEGUN + 15]])
    error = motion - whole[BEGUN : BEGUN + 15]
    return tuple(np.abs(error[:, [SIGNALS.index("motor_speed"), SIGNALS.index("yaw_rate")]]).max(axis=0))

  known, unknown = off(commands[BEGUN - KNOWN : BEGUN + 1]), off(commands[BEGUN])
  assert known[0] < 0.15 * unknown[0] and known[1] < 0.7 * unknown[1]


def test_a_stretch_knows_what_was_told_before_it_in_its_recording():
  time = PERIOD * np.arange(1500)
  volts, steering = 1.0 + 0.2 * np.sin(time), 0.1 * np.cos(time)
  streams = {"motor_voltage": volts, "steering_command": steering, "motor_speed": 100.0 * volts}
  recording = Recording("r", {name: Stream(time, value) for name, value in streams.items()})
  segments = cut_recordings([recording], QCAR, Cut(length=5.0)).segments
  assert segments.before.shape == (len(segments), KNOWN, 2)
  assert np.isnan(segments.before[0]).all()
  at = round(segments.offset[1] / PERIOD)
  np.testing.assert_allclose(segments.before[1], np.column_stack([volts, steering])[at - KNOWN : at])
  np.testing.assert_array_equal(segments[np.array([1])].before, segments.before[[1]])
