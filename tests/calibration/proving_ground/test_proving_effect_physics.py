"""What single effects of tyre, drive, body, sensors and beyond the catalogue do, against what their docstrings say."""

import dataclasses

import numpy as np
import pytest

from calibration.proving_ground import EFFECTS, Car, ProvingGroundPlant, Spec, make_sessions
from calibration.proving_ground.car import GRAVITY, fleet, one_of
from calibration.proving_ground.dynamics import rolling_start
from calibration.proving_ground.session import CLEAR, draw_effect, save_clean
from calibration.proving_ground.simulation import Carried, Simulation

PLAIN = Car(copper=0.0, discharge=0.0)
FREE = dataclasses.replace(PLAIN, motor_coulomb=0.0, motor_viscous=0.0, rolling_resistance=0.0)
SENSORS = (
  "imu_misalignment",
  "gyro_scale",
  "accel_bias",
  "clock_drift",
  "pose_mount",
  "accel_saturation",
  "gyro_magnet",
)


def effect(name: str, size: float = 1.0, columns: slice = slice(0, 1), seed: int = 0):
  return EFFECTS[name](size, columns, np.random.default_rng(seed))


def simulation(*effects, car: Car = PLAIN, n: int = 1, start=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)) -> Simulation:
  sim = Simulation(fleet([car], [n]), effects)
  sim.begin(np.tile(start, (n, 1)))
  return sim


def go(sim: Simulation, volts: float, steer: float, seconds: float) -> Simulation:
  for _ in range(round(seconds / 0.01)):
    sim.advance(np.array([[volts] * sim.n, [steer] * sim.n]))
  return sim


def changed(name: str, size: float = 1.0, car: Car = PLAIN) -> Car:
  """The car with what the effect does to its numbers."""
  columns = fleet([car], [1])
  effect(name, size).prepare(columns)
  return one_of(columns, 0)


@pytest.fixture(scope="module")
def sensed() -> dict:
  """Effect id -> tiny session without noise; '' is the one without effects."""
  specs = [Spec(31, ((name, 1.0),) if name else (), "tiny", 0.0) for name in ("", *SENSORS)]
  return dict(zip(("", *SENSORS), make_sessions(specs), strict=True))


def pairs(sensed: dict, name: str, channel: str):
  """Values of a channel without and with the effect, run by run."""
  for bare, hidden in zip(sensed[""].recordings, sensed[name].recordings, strict=True):
    yield bare[channel].value, hidden[channel].value


def test_wheel_radius_and_relaxation_change_the_cars_numbers():
  assert changed("wheel_radius_error", -1.0).wheel_radius == pytest.approx(0.96 * PLAIN.wheel_radius)
  assert changed("tyre_relaxation").relaxation == pytest.approx(PLAIN.relaxation + 0.07)


def test_longitudinal_slip_adds_its_share_at_two_metres_per_second_squared():
  """Slip at a steady pull of m 2 m/s^2, over all wheels."""
  slips = []
  for car in (FREE, changed("longitudinal_slip", car=FREE)):
    sim = simulation(car=car, start=(0, 0, 0, 1.5, 0, 0, 0))
    sim.dynamics.noise_wrench[0] = -2.0 * car.mass
    for _ in range(150):
      held = car.motor_constant * sim.dynamics.state.motor[0]
      need = 2.0 * car.mass * car.wheel_radius * car.gear_ratio * car.motor_resistance / car.motor_constant
      sim.advance(np.array([[held + need], [0.0]]))
    s = sim.dynamics.state
    slips.append(s.wheel.mean() * car.wheel_radius / s.vx[0] - 1)
  assert slips[1] - slips[0] == pytest.approx(
    0.04, rel=0.2
  )  # the tyre bends, and its slip is over the larger of two speeds


def test_tyre_saturation_takes_its_share_of_the_peak_and_little_before():
  ends = []
  for hidden in ((), (effect("tyre_saturation"),)):
    sim = go(simulation(*hidden, start=(0, 0, 0, 2.0, 0, 0, 0)), 2.5, 0.5, 0.3)
    slow = go(simulation(*hidden, start=(0, 0, 0, 1.0, 0, 0, 0)), 1.0, 0.03, 0.5)
    ends.append((np.hypot(*sim.dynamics.force[:, 1]).max(), slow.dynamics.state.yaw_rate[0]))
  assert ends[1][0] < 0.9 * ends[0][0]
  assert ends[1][1] == pytest.approx(ends[0][1], rel=0.01)


def test_combined_slip_takes_side_force_under_power_only():
  turns = []
  for hidden in ((), (effect("combined_slip", 2.0),)):
    coasting = simulation(*hidden, car=FREE, start=(0, 0, 0, 1.2, 0, 0, 0))
    coasting.dynamics.car.motor_resistance[:] = 1e6
    turns.append(
      (
        go(simulation(*hidden), 3.0, 0.15, 0.8).dynamics.state.yaw_rate[0],
        go(coasting, 0.0, 0.15, 0.6).dynamics.state.yaw_rate[0],
      )
    )
  assert abs(turns[1][0] / turns[0][0] - 1) > 0.01
  assert turns[1][1] == pytest.approx(turns[0][1], rel=5e-3)


def test_load_transfer_raises_the_centre_of_gravity_and_the_loads_it_moves():
  high = changed("load_transfer")
  assert high.cg_height == pytest.approx(PLAIN.cg_height + 0.025)
  moved = []
  for car in (PLAIN, high):
    load = go(simulation(car=car, start=(0, 0, 0, 1.5, 0, 0, 0)), 1.6, 0.2, 1.0).dynamics.load
    moved.append((load[1] + load[3] - load[0] - load[2])[0])
  assert moved[1] / moved[0] == pytest.approx(high.cg_height / PLAIN.cg_height, rel=0.05)


def test_friction_change_comes_half_way_through_the_session():
  n = 3
  sim = Simulation(fleet([PLAIN], [n]), (effect("friction_change", 1.0, slice(0, n)),))
  nothing, length = np.zeros(n), np.full(n, 600.0)
  sim.begin(np.zeros((n, 7)), carried=Carried(nothing, nothing, np.array([0.0, 300.0, 590.0]), length, length, length))
  sim.advance(np.zeros((2, n)))
  assert sim.dynamics.grip[0] == pytest.approx([1.0, 0.875, 0.75], abs=1e-3)


def test_side_force_pushes_a_rolling_car_and_not_a_standing_one():
  push = effect("side_force", -1.0)
  rolling, standing = (simulation(push, start=(0, 0, 0, v, 0, 0, 0)) for v in (1.0, 0.0))
  for sim in (rolling, standing):
    sim.dynamics.derivative()
  assert rolling.dynamics.wrench[1, 0] == pytest.approx(-0.7, rel=0.01)
  assert rolling.dynamics.wrench[2, 0] == pytest.approx(-0.7 * push.truth()["side_force_x"], rel=0.01)
  assert standing.dynamics.wrench[1, 0] == 0.0


def test_battery_sag_takes_its_share_at_stall():
  sim = simulation(effect("battery_sag"))
  sim.dynamics.car.mass[:] = 1e4  # it does not move away in the time
  sim.dynamics.car.motor_inertia[:] = 10.0
  sim.dynamics.__init__(sim.car)
  sim.begin(np.zeros((1, 7)))
  go(sim, 2.5, 0.0, 5.0)
  left = sim.dynamics.voltage[0] / 2.5
  expected = (np.sqrt(1 + 4 * 0.3) - 1) / (2 * 0.3)  # x (1 + 0.3 x) = 1: duty times a current that goes with x
  assert left == pytest.approx(expected, rel=0.01)


def test_the_drive_lag_has_the_sum_of_its_time_constants():
  sim = simulation(effect("drive_lag"))
  lag = 0.0
  for _ in range(100):
    sim.advance(np.array([[1.0], [0.0]]))
    lag += 0.01 * (1 - sim.dynamics.voltage[0])
  assert lag == pytest.approx(0.10, abs=0.006)


def test_heating_weakens_the_motor_and_cold_ones_are_whole():
  hot = effect("motor_heating", 1.0, slice(0, 2))
  sim = Simulation(fleet([PLAIN], [2]), (hot,))
  nothing, one = np.zeros(2), np.ones(2)
  sim.begin(np.zeros((2, 7)), carried=Carried(nothing, nothing, np.array([0.0, 5000.0]), 600 * one, 100 * one, one))
  sim.advance(np.zeros((2, 2)))
  assert sim.dynamics.constant / PLAIN.motor_constant == pytest.approx([1.0, 1 / 1.15], abs=1e-3)


def test_cogging_ripples_as_often_as_it_says():
  gear = effect("cogging")
  sim = go(simulation(gear), 1.2, 0.0, 1.5)
  turns, torque = [], []
  for _ in range(200):
    sim.advance(np.array([[1.2], [0.0]]))
    turns.append(sim.dynamics.state.motor_angle[0] * PLAIN.gear_ratio / (2 * np.pi))
    torque.append(sim.dynamics.motor_torque[0])
  cycles = np.sum(np.diff(np.sign(torque)) > 0) / (turns[-1] - turns[0])
  assert cycles == pytest.approx(gear.truth()["cogging_order"], rel=0.08)


def test_driveline_play_is_counted_at_the_motor():
  assert 2 * changed("driveline_backlash").shaft_play / PLAIN.gear_ratio == pytest.approx(1.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_lateral_offset_turns_the_car_under_power(side):
  sim = go(simulation(effect("cg_lateral_offset", side)), 2.5, 0.0, 0.15)
  assert np.sign(sim.dynamics.state.yaw_rate[0]) == side
  car = changed("cg_lateral_offset", side)
  assert car.imu_y == pytest.approx(PLAIN.imu_y - side * 0.014)


def test_a_payload_keeps_the_axles_and_the_instruments_where_they_are():
  box = effect("payload")
  columns = fleet([PLAIN], [1])
  box.prepare(columns)
  car, truth = one_of(columns, 0), box.truth()
  assert car.wheelbase == pytest.approx(PLAIN.wheelbase)
  assert car.mass == pytest.approx(PLAIN.mass + truth["payload_mass"])
  shift = truth["payload_x"] * truth["payload_mass"] / car.mass
  assert car.cg_to_front == pytest.approx(PLAIN.cg_to_front - shift)
  assert car.imu_x == pytest.approx(PLAIN.imu_x - shift)
  assert car.marker_x == pytest.approx(-shift)
  assert car.yaw_inertia > PLAIN.yaw_inertia


def test_a_locked_differential_resists_turning_up_to_its_preload():
  sim = simulation(effect("differential_lock"), start=(0, 0, 0, 0.4, 0, 0, 0))
  go(sim, 0.6, 0.35, 1.0)
  torque = sim.dynamics.wheel_torque[:, 0]
  assert torque[[0, 2]] == pytest.approx(-torque[[1, 3]])
  assert torque[0] > 0 > torque[1]  # it drives the inner, slower wheel
  assert torque[0] - torque[1] == pytest.approx(0.04, rel=0.15)


def test_dry_friction_and_film_drag_have_the_forces_they_state():
  for name, speed, force in (("coulomb_friction", 1.5, 1.0), ("quadratic_drag", 1.5, 0.4 * 1.5**2)):
    sim = simulation(effect(name), start=(0, 0, 0, speed, 0, 0, 0))
    sim.dynamics.derivative()
    wheels = sim.dynamics.wheel_torque.sum() / PLAIN.wheel_radius
    assert -(sim.dynamics.wrench[0, 0] + wheels) == pytest.approx(force, rel=0.01)


def test_stiction_raises_the_breakaway_voltage():
  """Below the voltage that overcomes friction and stiction together the car stays."""
  lever = PLAIN.gear_ratio * PLAIN.wheel_radius
  kinetic = PLAIN.motor_coulomb + lever * PLAIN.rolling_resistance * PLAIN.mass * GRAVITY
  volts = (kinetic + 0.5 * lever * 0.7) * PLAIN.motor_resistance / PLAIN.motor_constant
  free, stuck = (go(simulation(*e), volts, 0.0, 1.5).dynamics.state.vx[0] for e in ((), (effect("stiction"),)))
  assert free > 0.02
  assert abs(stuck) < 2e-3


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
