"""Manoeuvres, paths, driver and sensors of the proving ground."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.concealed.laboratory import manoeuvres as m
from calibration.concealed.laboratory.designs import DESIGNS
from calibration.concealed.laboratory.driver import Driver, coloured, shaking, stack_paths
from calibration.concealed.proving_ground import Spec, make_sessions
from calibration.concealed.proving_ground.car import Car, fleet
from calibration.concealed.proving_ground.sensing import EDGES, Log, add_noise
from calibration.concealed.proving_ground.simulation import Simulation

BELIEF = {
  "wheelbase": 0.256,
  "speed_per_motor": 3.147e-3,
  "volts_per_speed": 1.0,
  "volts_to_move": 0.2,
  "max_steering": 0.5236,
  "answer": 1.0,
  "tremor": 1.0,
  "limit": 4.0,
  "step": 1e-3,
}


def belief(n: int) -> SimpleNamespace:
  return SimpleNamespace(**{name: np.full(n, value) for name, value in BELIEF.items()})


def logged(effect=None, ticks=40, volts=1.5) -> Log:
  """A noise-free log of two cars driving straight."""
  sim = Simulation(fleet([Car()], [2]), () if effect is None else (effect,))
  sim.begin(np.zeros((2, 7)), ticks=ticks)
  for _ in range(ticks):
    sim.advance(np.array([[volts, volts], [0.0, 0.1]]))
  return Log(sim, ticks)


def test_a_path_of_constant_curvature_is_a_circle():
  path = m.Path.from_curvature(np.full(400, 0.8), x=1.0, y=-1.25)
  radius = np.hypot(path.x - 1.0, path.y)
  assert radius == pytest.approx(1.25, rel=2e-3)
  assert path.yaw[-1] == pytest.approx(0.8 * 0.02 * 399.5)


def test_the_oval_closes():
  line = m.oval(1.0, 30.0, "identify").path
  lap = 2 * (60 + round(np.pi * 0.9 / m.SPACING) + 60)
  assert line.yaw[lap + 60] - line.yaw[60] == pytest.approx(2 * np.pi)
  assert np.hypot(line.x[lap + 60] - line.x[60], line.y[lap + 60] - line.y[60]) < 1e-6
  assert np.ptp(line.x) < 6 and np.ptp(line.y) < 4


@pytest.mark.parametrize("seed", range(5))
def test_free_drives_stay_in_the_room_and_within_their_lateral_acceleration(seed):
  run = m.free_drive(np.random.default_rng(seed), 14.0, "holdout", "free")
  assert np.abs(run.path.x).max() < 5 and np.abs(run.path.y).max() < 4
  assert run.speed.max() ** 2 * np.quantile(np.abs(run.path.curvature), 0.98) < 3.25
  assert len(run.path.x) * m.SPACING > run.speed.sum() * m.PERIOD


def test_held_levels_last_as_long_as_asked():
  values = m.held(np.random.default_rng(0), 2000, np.array([0.0, 1.0, 2.0, 3.0]), 0.3, 0.6)
  jumps = np.flatnonzero(np.diff(values))
  assert np.diff(jumps).min() >= 30


def test_excitation_drives_both_ways_and_steers_to_both_sides():
  run = m.excitation(np.random.default_rng(0), 14.0, "identify", "x")
  assert run.volts.min() < -0.5 < 1.0 < run.volts.max()
  assert run.steer.min() < -0.1 < 0.1 < run.steer.max()


def test_the_chirp_sweeps_its_frequencies():
  run = m.chirp(1.0, 12.0, "identify", "chirp")
  swing = run.steer - np.deg2rad(7.0)
  crossings = np.flatnonzero(np.diff(np.sign(swing)))
  assert 0.5 / (0.01 * (crossings[2] - crossings[1])) < 0.6
  assert 0.5 / (0.01 * (crossings[-1] - crossings[-2])) == pytest.approx(5.0, rel=0.15)


def test_coloured_noise_has_unit_variance_and_its_memory():
  noise = coloured(np.random.default_rng(0), (20000, 20), 0.1)
  assert noise.std() == pytest.approx(1.0, abs=0.02)
  assert np.mean(noise[10:] * noise[:-10]) == pytest.approx(np.exp(-1), abs=0.03)
  assert noise[0].std() == pytest.approx(1.0, abs=0.35)


def test_open_loop_commands_come_out_as_written():
  run = m.voltage_step(1.25, "identify", 1.0)
  driver = Driver([run], np.zeros((100, 4, 1)), belief(1))
  commands = np.stack([driver.commands(k, *np.zeros((4, 1))) for k in range(100)])
  assert commands[:, 0, 0].tolist() == [0.0] * 50 + [1.25] * 50
  assert np.all(commands[:, 1] == 0.0)


def test_the_speed_holder_pushes_towards_the_wish():
  run = m.at_speed("x", "circle", "identify", np.full(100, 1.0))
  driver = Driver([run, run], np.zeros((100, 4, 2)), belief(2))
  motor = np.array([0.8, 1.2]) / BELIEF["speed_per_motor"]
  volts = driver.commands(0, *np.zeros((3, 2)), motor)[0]
  assert volts[0] > 1.2 > volts[1]
  later = [driver.commands(k, *np.zeros((3, 2)), motor)[0] for k in range(1, 50)][-1]
  assert later[0] > volts[0] and later[1] < volts[1]


def test_the_follower_steers_back_to_its_line():
  path = m.Path.from_curvature(np.zeros(500))
  run = m.at_speed("x", "oval", "identify", np.full(100, 1.0), path=path)
  driver = Driver([run, run], np.zeros((100, 4, 2)), belief(2))
  motor = np.full(2, 1.0 / BELIEF["speed_per_motor"])
  steer = [driver.commands(k, np.zeros(2), np.array([0.2, -0.2]), np.zeros(2), motor)[1] for k in range(30)][-1]
  assert steer[0] < -0.1 and steer[1] == pytest.approx(-steer[0])


def test_commands_keep_their_limits_and_their_resolution():
  run = m.open_loop("x", "excitation", "identify", np.full(50, 9.0), 2.0)
  driver = Driver([run], shaking(np.random.default_rng(0), 50, 1), belief(1))
  volts, steer = driver.commands(3, *np.zeros((4, 1)))[:, 0]
  assert (volts, steer) == (4.0, pytest.approx(0.5236, abs=1e-4))
  run = m.open_loop("x", "excitation", "identify", np.full(50, 1.0), 0.1)
  volts, steer = Driver([run], shaking(np.random.default_rng(0), 50, 1), belief(1)).commands(3, *np.zeros((4, 1)))[:, 0]
  assert volts != 1.0 and round(volts, 3) == pytest.approx(volts, abs=1e-12)


def test_paths_of_different_lengths_stand_side_by_side():
  stacked = stack_paths([None, m.Path.from_curvature(np.zeros(5)), m.Path.from_curvature(np.zeros(3))])
  assert stacked.x.shape == (5, 3)
  assert stacked.x[-1].tolist() == pytest.approx([0.0, 0.10, 0.06])


@pytest.mark.slow
def test_the_driver_stays_on_the_oval(monkeypatch):
  run = m.oval(1.0, 7.0, "holdout")
  monkeypatch.setitem(DESIGNS, "loop", lambda rng: [run])
  for session in make_sessions([Spec(seed, (), "loop") for seed in range(4)]):
    state = session.clean["oval"]
    off = [np.min(np.hypot(run.path.x - x, run.path.y - y)) for x, y in state[::20, :2]]
    assert max(off) < 0.15
    assert state[200:, 3] == pytest.approx(1.0, abs=0.12)


def test_the_encoder_counts_edges():
  log = logged()
  speed = log.channels["motor_speed"]
  edge = 2 * np.pi / EDGES / 4e-3
  assert speed / edge == pytest.approx(np.round(speed / edge), abs=1e-6)
  assert speed[20:, 0] == pytest.approx(log.state("motor", 2e-3)[20:, 0], abs=1.05 * edge)


def test_the_accelerometer_differentiates_the_speed_on_the_straight():
  log = logged()
  slope = np.gradient(log.state("vx")[:, 0], 0.01)
  assert log.channels["accel_x"][15:-1, 0] == pytest.approx(slope[15:-1], rel=0.04)


def test_the_accelerometer_feels_its_lever_arm():
  car = fleet([Car(imu_x=0.0, imu_y=0.0), Car(imu_x=0.1, imu_y=0.0)], [1, 1])
  sim = Simulation(car)
  start = np.zeros((2, 7))
  start[:, 3] = 1.0
  sim.begin(start, ticks=150)
  for _ in range(150):
    sim.advance(np.array([[1.2, 1.2], [0.2, 0.2]]))
  log = Log(sim, 150)
  yaw_rate = log.state("yaw_rate")[-1, 0]
  assert np.diff(log.channels["accel_x"][-1])[0] == pytest.approx(-(yaw_rate**2) * 0.1, rel=0.05)


def test_a_late_signal_is_interpolated_on_the_fine_grid():
  log = logged()
  assert log.state("x", np.zeros(2)) == pytest.approx(log.state("x"))
  assert log.state("x", 0.010)[5:] == pytest.approx(log.state("x")[4:-1])
  middle = log.state("x", 0.0037)[20:, 0]
  between = np.stack([log.state("x")[19:-1, 0], log.state("x")[20:, 0]])
  assert np.all((middle > between[0]) & (middle < between[1]))


def test_noise_of_level_zero_adds_nothing_but_a_score():
  log = logged()
  clean = add_noise(log.channels, log.vibration, 0.0, np.random.default_rng(0))
  assert all(np.array_equal(clean[name], log.channels[name]) for name in log.channels)
  assert clean["pose_score"] == pytest.approx(0.92)


def test_poses_far_off_have_a_low_score():
  still = {
    name: np.zeros((20000, 2))
    for name in ("accel_x", "accel_y", "yaw_rate", "motor_speed", "pose_x", "pose_y", "pose_yaw")
  }
  noisy = add_noise(still, np.zeros((20000, 2)), 1.0, np.random.default_rng(0))
  off = np.hypot(noisy["pose_x"], noisy["pose_y"])
  assert off[noisy["pose_score"] < 0.5].mean() > 5 * np.median(off)
  assert 0.003 < np.median(off) < 0.012
  assert noisy["yaw_rate"].std() == pytest.approx(0.006, rel=0.1)
  assert np.all(noisy["motor_speed"] == 0.0)
