"""What effects on sensors and beyond the catalogue do, against what their docstrings say."""

import numpy as np
import pytest

from calibration.concealed.laboratory.written import save_clean
from calibration.concealed.proving_ground import EFFECTS, ProvingGroundPlant, Spec, make_sessions
from calibration.concealed.proving_ground.car import fleet
from calibration.concealed.proving_ground.dynamics import rolling_start
from calibration.concealed.proving_ground.session import CLEAR, draw_effect
from calibration.concealed.proving_ground.simulation import Simulation
from tests.calibration.concealed.proving_ground.effect_bench import PLAIN, effect, go, simulation

SENSORS = (
  "imu_misalignment",
  "gyro_scale",
  "accel_bias",
  "clock_drift",
  "pose_mount",
  "accel_saturation",
  "gyro_magnet",
)


@pytest.fixture(scope="module")
def sensed() -> dict:
  """Effect id -> tiny session without noise; '' is the one without effects."""
  specs = [Spec(31, ((name, 1.0),) if name else (), "tiny", 0.0) for name in ("", *SENSORS)]
  return dict(zip(("", *SENSORS), make_sessions(specs), strict=True))


def pairs(sensed: dict, name: str, channel: str):
  """Values of a channel without and with the effect, run by run."""
  for bare, hidden in zip(sensed[""].recordings, sensed[name].recordings, strict=True):
    yield bare[channel].value, hidden[channel].value


def test_sensor_scales_and_zeros(sensed):
  for bare, hidden in pairs(sensed, "gyro_scale", "yaw_rate"):
    assert hidden == pytest.approx(1.05 * bare, abs=2e-4)
  bias = sensed["accel_bias"].truth["effects"][0]["parameters"]
  for channel in ("accel_x", "accel_y"):
    for bare, hidden in pairs(sensed, "accel_bias", channel):
      assert hidden - bare == pytest.approx(bias[f"accel_bias_{channel[-1]}"], abs=4e-3)
  assert np.hypot(*bias.values()) == pytest.approx(0.2)


def test_a_turned_imu_mixes_its_axes(sensed):
  turned = np.deg2rad(5.0)
  for (a, a_turned), (b, b_turned) in zip(
    pairs(sensed, "imu_misalignment", "accel_x"), pairs(sensed, "imu_misalignment", "accel_y"), strict=True
  ):
    assert a_turned == pytest.approx(np.cos(turned) * a + np.sin(turned) * b, abs=2e-3)
    assert b_turned == pytest.approx(np.cos(turned) * b - np.sin(turned) * a, abs=2e-3)


def test_a_pose_mount_turns_and_shifts_the_pose(sensed):
  mount = sensed["pose_mount"].truth["effects"][0]["parameters"]
  for bare, hidden in pairs(sensed, "pose_mount", "pose_yaw"):
    assert hidden - bare == pytest.approx(np.deg2rad(2.0), abs=2e-4)
  arm = np.hypot(mount["pose_mount_x"], mount["pose_mount_y"])
  for (x, x_hidden), (y, y_hidden) in zip(
    pairs(sensed, "pose_mount", "pose_x"), pairs(sensed, "pose_mount", "pose_y"), strict=True
  ):
    assert np.hypot(x_hidden - x, y_hidden - y) == pytest.approx(arm, abs=2e-4)


def test_clock_drift_grows_with_the_time_of_the_run(sensed):
  run = next(r for r in sensed["clock_drift"].recordings if r.name == "oval")
  truth = sensed["clock_drift"].clean["oval"][:, 0]
  stream = run["pose_x"]
  moved = np.interp((1 - 0.006) * stream.time, 0.01 * np.arange(len(truth)), truth)
  assert stream.value == pytest.approx(moved, abs=3e-4)


def test_a_saturated_accelerometer_reads_less_and_never_more_than_its_ceiling(sensed):
  for bare, hidden in pairs(sensed, "accel_saturation", "accel_x"):
    assert np.all(np.abs(hidden) <= np.abs(bare) + 1e-3)
    assert np.abs(hidden).max() < 4.0


def test_the_magnet_is_tied_to_its_place(sensed):
  place = sensed["gyro_magnet"].truth["effects"][0]["parameters"]
  for run, (bare, hidden) in zip(sensed[""].recordings, pairs(sensed, "gyro_magnet", "yaw_rate"), strict=True):
    x, y = sensed[""].clean[run.name][:, :2].T
    near = (x - place["x"]) ** 2 + (y - place["y"]) ** 2
    assert hidden - bare == pytest.approx(0.12 / (1 + near**2 / 0.8**4), abs=2e-4)


def test_shimmy_swings_with_the_square_of_the_speed():
  swings = []
  for speed in (0.75, 1.5):
    sim = simulation(effect("steering_shimmy"), start=(0, 0, 0, speed, 0, 0, 0))
    angles = []
    for _ in range(24):
      sim.dynamics.state.vx[:] = speed
      sim.advance(np.array([[speed], [0.0]]))
      angles.append(sim.road[0])
    swings.append(np.ptp(angles) / 2)
  assert swings[1] == pytest.approx(0.015, rel=0.06)
  assert swings[1] / swings[0] == pytest.approx(4.0, rel=0.08)


def test_torque_steer_remembers_the_current_it_came_from():
  pull = effect("torque_steer")
  pull.memory = np.array([0.0])
  sim = simulation(pull)
  angles = []
  for current in (5.0, 3.0, 5.0):
    sim.road[:] = 0.0
    sim.dynamics.current = np.array([current])
    pull.link(sim)
    angles.append(sim.road[0])
  assert angles[0] == pytest.approx(6e-3 * 8 * np.tanh(0.5))
  assert angles[1] == angles[2] == pytest.approx(angles[0])  # within the play nothing moves


def test_warm_tyres_lose_grip_and_forget():
  hot = effect("tyre_temperature")
  sim = go(simulation(hot, start=(0, 0, 0, 2.0, 0, 0, 0)), 2.5, 0.45, 1.0)
  worst = sim.dynamics.grip.min()
  assert worst < 0.85
  go(sim, 0.0, 0.0, 4.0)
  assert sim.dynamics.grip.min() > worst + 0.25 * (1 - worst)


def test_the_wind_is_felt_with_the_square_of_the_air_speed():
  fan = effect("side_wind")
  toward = np.arctan2(fan.wind[1], fan.wind[0])
  sim = simulation(fan, n=1)
  forces = []
  for speed in (0.5, -0.5):  # against the wind and with it
    rolling_start(sim.dynamics, np.array([[0, 0, toward + np.pi, speed, 0, 0, 0.0]]))
    sim.dynamics.state.motor[:] = 400.0
    sim.dynamics.stage.array[:] = sim.dynamics.state.array
    sim.dynamics.derivative()
    forces.append(sim.dynamics.wrench[0, 0])
  assert forces[0] / forces[1] == pytest.approx((3.5 / 2.5) ** 2, rel=1e-6)
  assert forces[0] < 0


def test_a_dropout_holds_whole_words_for_a_while():
  lost = effect("radio_dropout", 3.0)
  sim = simulation(lost)
  kept = []
  for k in range(300):
    sim.advance(np.array([[0.001 * k], [0.0]]))
    kept.append(sim.command[0, 0])
  held = np.diff(kept) == 0.0
  longest = max(len(part) for part in "".join("x" if h else " " for h in held).split())
  assert 10 <= longest <= 90
  assert 0.05 < held.mean() < 0.7


def test_carpet_changes_with_twice_the_heading_and_imbalance_with_the_square_of_the_speed():
  pile = effect("carpet_pile")
  forces = []
  for yaw in (pile.grain, pile.grain + np.pi / 2, pile.grain + np.pi):
    sim = simulation(pile, start=(0, 0, yaw, 1.0, 0, 0, 0))
    sim.dynamics.derivative()
    forces.append(sim.dynamics.wrench[0, 0])
  assert forces == pytest.approx([-0.8, 0.8, -0.8], rel=1e-6)
  pushes = []
  for speed in (0.7, 1.4):
    sim = simulation(effect("wheel_imbalance"), start=(0, 0, 0, speed, 0, 0, 0))
    sim.dynamics.stage.motor_angle[:] = np.pi / 2 / PLAIN.gear_ratio
    sim.dynamics.derivative()
    pushes.append(sim.dynamics.wrench[0, 0])
  assert pushes[1] / pushes[0] == pytest.approx(4.0)


def test_a_drawn_effect_is_a_clear_one_of_the_catalogue():
  drawn = [draw_effect(np.random.default_rng(seed)) for seed in range(60)]
  assert set(CLEAR) <= {name for name in EFFECTS if EFFECTS[name].catalogue}
  assert len({name for name, _ in drawn}) > 10
  assert all(0.85 <= abs(size) <= 1.25 for _, size in drawn)
  assert all(size > 0 or EFFECTS[name].signed for name, size in drawn)


def test_clean_states_are_written_whole(tmp_path, sensed):
  save_clean(sensed[""], tmp_path)
  with np.load(tmp_path / "clean.npz", allow_pickle=False) as file:
    assert set(file.files) == set(sensed[""].clean)
    assert np.array_equal(file["excitation"], sensed[""].clean["excitation"])
  assert [entry.name for entry in tmp_path.iterdir()] == ["clean.npz"]


def test_hooks_of_a_plant_see_only_their_own_cars():
  """An effect on the first of two cars leaves the second as it was."""
  both = Simulation(
    fleet([PLAIN], [2]), (effect("steering_offset", 1.0, slice(0, 1)), effect("coulomb_friction", 1.0, slice(0, 1)))
  )
  both.begin(np.zeros((2, 7)))
  go(both, 1.5, 0.1, 0.5)
  alone = ProvingGroundPlant(PLAIN).begin(np.zeros((1, 7)))
  for _ in range(50):
    alone.step(np.array([[1.5, 0.1]]))
  assert both.dynamics.state.yaw_rate[1] == alone.signals[0, 5]
  assert both.dynamics.state.yaw_rate[0] != alone.signals[0, 5]
