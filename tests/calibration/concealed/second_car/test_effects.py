"""Every concealed effect of the second car moves what is driven or read to the side that its name says."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.concealed.second_car import SECOND_EFFECTS
from calibration.concealed.second_car.car import GRAVITY, SecondCar
from calibration.concealed.second_car.chassis import rest_loads
from calibration.concealed.second_car.drive import swallowed
from calibration.concealed.second_car.effects import SIZES, conceal, draw_second_effect, second_effect
from calibration.concealed.second_car.sensing import sense
from calibration.concealed.second_car.simulation import SIGNALS, columns
from qcar_twin.twin.mechanisms import catalogue
from tests.calibration.concealed.second_car.second_car_rig import CAR, changed, go, side_by_side

ROW = {name: i for i, name in enumerate(SIGNALS)}
STRAIGHT = ("drive_dead_zone", "drive_lag", "battery_sag", "quadratic_drag", "payload", "wheel_radius_error")
TURN = ("steering_lag", "steering_offset", "steering_gain_error", "steering_dead_zone", "steering_backlash",
        "differential_lock", "tyre_relaxation", "friction_patch", "side_force", "floor_slope")  # fmt: skip


def driven(names, *args, **options):
  """Trace (rows, signals) of the bare car and of each effect's, by name."""
  simulation, _ = go([CAR, *(changed(name) for name in names)], *args, **options)
  return {name: simulation.trace[:, :, i] for i, name in enumerate(("bare", *names))}


@pytest.fixture(scope="module")
def straight():
  """From rest, 1.6 V for 0.7 s."""
  return driven(STRAIGHT, lambda t: (1.6 if t >= 0.05 else 0.0, 0.0), 0.75)


@pytest.fixture(scope="module")
def turn():
  """Rolling at 1.2 m/s in a straight line, then 8 degrees to the left."""
  return driven(TURN, lambda t: (1.35, 0.14 if t >= 0.1 else 0.0), 0.55, speed=1.2)


@pytest.mark.parametrize("name", STRAIGHT[:-1])
def test_what_holds_back_a_start(straight, name):
  assert straight[name][-1, ROW["vx"]] < straight["bare"][-1, ROW["vx"]] - 0.01


def test_larger_wheels_go_farther_for_the_same_turns(straight):
  ratio = {name: trace[-1, ROW["x"]] / trace[-1, ROW["motor_angle"]] for name, trace in straight.items()}
  assert ratio["wheel_radius_error"] / ratio["bare"] == pytest.approx(1.04, abs=3e-3)


def test_stiction_holds_a_car_that_would_creep_and_no_fast_one():
  """What just moves the car does not break it away; at speed the same force is gone."""
  cars, volts = [CAR, changed("stiction")], CAR.drive_line()[1] + 0.04
  creeping, _ = go(cars, lambda _t: (volts, 0.0), 0.9)
  assert creeping.state.x[0] > 2 * abs(creeping.state.x[1])
  fast, _ = go(cars, lambda _t: (1.6, 0.0), 0.1, speed=1.2)
  assert fast.state.u[1] == pytest.approx(fast.state.u[0], rel=1e-6)


def test_a_sagging_battery_loses_what_its_size_says():
  """On a motor that stands, a command of 2.5 V arrives as 2.5 V / (1 + s)."""
  car = changed("battery_sag")
  heavy = [replace(c, motor_inertia=1e3, pack_time=0.02) for c in (CAR, car)]
  simulation, _ = go(heavy, lambda _t: (2.5, 0.0), 0.15)
  bare, sagging = simulation.state.current * CAR.motor_resistance
  assert bare / sagging == pytest.approx(1.3, rel=5e-3)


@pytest.mark.parametrize("name", ["steering_dead_zone", "steering_lag", "differential_lock", "tyre_relaxation"])
def test_what_keeps_the_car_from_turning(turn, name):
  assert turn[name][-1, ROW["yaw"]] < turn["bare"][-1, ROW["yaw"]] - 5e-4


@pytest.mark.parametrize("name", ["steering_offset", "steering_gain_error", "side_force"])
def test_what_takes_the_car_to_the_left(turn, name):
  assert turn[name][-1, ROW["y"]] > turn["bare"][-1, ROW["y"]] + 1e-3


def test_play_is_half_of_it_behind(turn):
  behind = turn["bare"][-1, ROW["road"]] - turn["steering_backlash"][-1, ROW["road"]]
  assert behind == pytest.approx(0.5 * np.radians(1.5), rel=0.05)


def test_a_leaning_floor_pulls_and_the_imu_feels_what_holds():
  car = replace(CAR, slope_x=0.2)
  simulation, _ = go([CAR, car], lambda _t: (0.0, 0.0), 0.3, speed=1.0)
  speed = simulation.trace[:, ROW["vx"]]
  gained = speed[-1, 1] - speed[-1, 0]
  assert 0.3 * 0.2 * 0.4 < gained < 0.3 * 0.2  # wheels and motor turn with it
  felt = simulation.trace[:, ROW["accel_x"]] - np.gradient(speed, 2e-3, axis=0)
  assert np.diff(felt[10:-10].mean(axis=0))[0] == pytest.approx(-0.2, abs=0.01)


def test_a_slippery_place_takes_grip_only_there():
  car = replace(CAR, patch_loss=0.7, patch_x=0.0, patch_y=0.0, patch_radius=2.0)
  simulation, _ = go([CAR, car, replace(car, patch_x=50.0)], lambda _t: (3.0, 0.28), 0.25, speed=2.2)
  pushed = np.abs(simulation.trace[:, ROW["accel_y"]]).max(axis=0)
  assert pushed[1] < 0.8 * pushed[0]
  assert pushed[2] == pytest.approx(pushed[0], rel=1e-3)


def test_negative_voltages_are_stronger():
  simulation, _ = go([CAR, changed("drive_asymmetry")], lambda _t: (-1.5, 0.0), 0.4)
  assert simulation.state.u[1] < 1.04 * simulation.state.u[0] < 0.0


@pytest.mark.parametrize(("name", "signal", "row"), [("steering_delay", "road", 1), ("drive_delay", "motor", 0)])
def test_commands_arrive_late(name, signal, row):
  """The mean lateness is the effect's; packets differ by a tenth."""
  command = lambda t: (1.0, 0.2) if t >= 0.05 else (0.0, 0.0)
  first = []
  for car in (CAR, changed(name)):
    simulation, _ = go([car], command, 0.2)
    trace = simulation.trace[:, ROW[signal], 0]
    risen = np.maximum.accumulate(np.abs(trace)) / 0.2
    first.append(2e-3 * float(np.argmax(risen > 0.1)))
  assert first[1] - first[0] == pytest.approx(SECOND_EFFECTS[name].typical, rel=0.25)


def test_a_battery_to_one_side_loads_that_side_and_turns_under_power():
  car = changed("cg_lateral_offset")
  load = rest_loads(columns(car, 1))[:, 0]
  assert load[0] + load[2] > load[1] + load[3]
  simulation, _ = go([CAR, car], lambda _t: (3.0, 0.0), 0.4)
  assert simulation.state.yaw[1] > simulation.state.yaw[0] + 1e-3  # the wheels push right of the centre of gravity
  assert car.marker_y == pytest.approx(-0.014)


def test_a_box_adds_its_mass_and_moves_what_is_bolted_on():
  car = changed("payload")
  assert car.mass - CAR.mass == pytest.approx(0.55)
  assert car.cg_to_front + car.cg_to_rear == pytest.approx(CAR.wheelbase)
  assert car.imu_x - CAR.imu_x == pytest.approx(car.marker_x) == pytest.approx(car.cg_to_front - CAR.cg_to_front)
  assert rest_loads(columns(car, 1)).sum() == pytest.approx((CAR.mass + 0.55) * GRAVITY)


def test_sensors_err_as_told():
  simulation, _ = go([CAR], lambda t: (2.0, 0.2 * np.sin(6 * t)), 0.8, speed=1.2)
  read = lambda car: sense(side_by_side([car]), simulation.trace, 0.0, np.random.default_rng(0))
  bare = read(CAR)
  assert read(changed("gyro_scale"))["yaw_rate"] == pytest.approx(1.05 * bare["yaw_rate"])
  twisted, angle = read(changed("imu_misalignment")), np.radians(5)
  assert twisted["accel_x"] == pytest.approx(np.cos(angle) * bare["accel_x"] + np.sin(angle) * bare["accel_y"])
  late = read(changed("imu_latency"))["yaw_rate"][:, 0]
  at = np.arange(20, 80)
  lag = [
    np.sum((late[at] - np.interp(at - d / 0.01, np.arange(80), bare["yaw_rate"][:, 0])) ** 2) for d in (0.0, 0.055)
  ]
  assert lag[1] < 0.02 * lag[0]
  assert np.array_equal(bare["motor_speed"], read(changed("gyro_scale"))["motor_speed"])


def test_a_dead_zone_swallows_its_width():
  zone = np.full(3, 0.15)
  assert swallowed(np.array([-1.0, 0.0, 2.0]), zone) == pytest.approx([-0.85, 0.0, 1.85], abs=0.01)
  assert abs(swallowed(np.array([0.05]), zone[:1])[0]) < 0.01
  assert swallowed(np.array([0.3]), np.zeros(1)) == pytest.approx([0.3])


def test_every_effect_is_in_the_catalogue_and_changes_the_car():
  for name, kind in SECOND_EFFECTS.items():
    mechanism = catalogue()[name]
    car, told = conceal(CAR, ((name, 1.0),), np.random.default_rng(1))
    assert car != CAR
    assert told[0]["subsystem"] == kind.subsystem
    assert set(told[0]["parameters"]) <= {p.name for p in mechanism.parameters}, name


def test_drawn_effects_are_of_about_typical_size():
  drawn = [draw_second_effect(np.random.default_rng(seed)) for seed in range(200)]
  sizes = np.array([size for _, size in drawn])
  assert SIZES[0] <= np.abs(sizes).min() < np.abs(sizes).max() <= SIZES[1]
  assert {name for name, size in drawn if size < 0} <= {name for name, kind in SECOND_EFFECTS.items() if kind.signed}
  assert len({name for name, _ in drawn}) == len(SECOND_EFFECTS)


def test_bad_effects_are_refused():
  with pytest.raises(KeyError, match="did you mean 'battery_sag'"):
    second_effect("batery_sag", 1.0)
  with pytest.raises(ValueError, match="no negative size, got -1"):
    second_effect("stiction", -1.0)


def test_cars_are_drawn_within_their_ranges():
  cars = [SecondCar.draw(np.random.default_rng(seed)) for seed in range(100)]
  assert 2.3 <= min(car.mass for car in cars) < max(car.mass for car in cars) <= 3.0
  assert len({car.gear_friction for car in cars}) == 100
