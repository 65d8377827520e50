"""Starts in mid-drive: what encoder, gyro and accelerometer say of a car that slips becomes the state it is in."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.plant import START, Segments, signal_index
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.parameters import quantities
from qcar_twin.twin.starts import slipping, turning
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import GRAVITY, QCAR, Vehicle

TWIN = Twin(QCAR, [], threads=1, engine="reduced")
SENSED = np.zeros((1, len(START)), dtype=bool)
PERIOD, TRAVEL = TWIN.period, QCAR.gear_ratio * QCAR.wheel_radius  # s; m/rad
MOTOR, PUSH = signal_index("motor_speed"), signal_index("accel_x")
VALUES = {name: np.array([p.nominal]) for name, p in zip(TWIN.base.names, TWIN.base, strict=True)}


def driven(volts: float, steering: float, seconds: float, start: np.ndarray, twin: Twin = TWIN) -> np.ndarray:
  """Signals of a car after each control period, (T, 10)."""
  cars = twin.begin(twin.parameters.nominal[None], start[None])
  return np.concatenate([cars.step(np.array([[volts, steering]])).copy() for _ in range(round(seconds / PERIOD))])


def measured(signals: np.ndarray, at: int, vehicle: Vehicle = QCAR) -> np.ndarray:
  """A start state, (7,), as encoder and gyro say it."""
  state = np.zeros(len(START))
  turn = signals[at, signal_index("yaw_rate")]
  state[3:] = TRAVEL * signals[at, MOTOR], turn * vehicle.cg_to_rear, turn, signals[at, -1]
  return state


def begun(signals: np.ndarray, at: int) -> np.ndarray:
  """The twin's start state, (7,), from what is measured about a control period."""
  return slipping(measured(signals, at)[None], signals[at, [PUSH]], VALUES, QCAR)[0]


@pytest.mark.parametrize("at", [15, 30])
@pytest.mark.parametrize("volts", [2.5, -2.5])
def test_a_start_in_a_launch_is_slower_than_its_wheels_by_their_slip(volts, at):
  signals = driven(volts, 0.0, 0.5, np.zeros(7))
  error = begun(signals, at)[3] - signals[at, 3]
  assert abs(error) < 0.35 * abs(TRAVEL * signals[at, MOTOR] - signals[at, 3])


def test_a_start_in_a_turn_slides_as_its_rear_tyres_do():
  start = np.zeros(7)
  start[3] = 1.2
  signals = driven(1.2, 0.2, 3.0, start)
  rolling, truth = measured(signals, -20)[4], signals[-20, 4]
  assert abs(begun(signals, -20)[4] - truth) < 0.35 * abs(rolling - truth)


@pytest.mark.parametrize(("volts", "steering"), [(2.5, 0.4), (3.0, 0.35), (3.0, 0.2)])
def test_a_start_near_the_limit_of_grip_has_slid_out(volts, steering):
  """At 0.87 to 0.94 of the grip linear tyres have slid out by 0.08 m/s and more too little."""
  signals = driven(volts, steering, 4.0, np.zeros(7))
  truth, used = signals[-20, 4], signals[-20, 3] * signals[-20, 5] / (0.8 * GRAVITY)
  assert used > 0.85
  linear = dict(VALUES, friction_coefficient=np.array([100.0]))
  slid = slipping(measured(signals, -20)[None], signals[[-20], PUSH], linear, QCAR)[0, 4]
  assert abs(begun(signals, -20)[4] - truth) < 0.02 < 0.05 < abs(slid - truth)


def slow_turn(twin: Twin) -> np.ndarray:
  """Signals in a steady circle with the wheels turned far."""
  start = np.zeros(7)
  start[3] = 0.5
  return driven(0.8, 0.45, 3.0, start, twin)


@pytest.mark.parametrize(("volts", "steering"), [(1.5, 0.45), (2.5, 0.4), (3.0, 0.2)])
def test_a_start_in_a_fast_turn_knows_what_the_steered_wheels_hold_back(volts, steering):
  """The force towards the centre, at 2.6 to 7 m/s^2, brakes the car by its sine, and driven wheels make up for it."""
  signals = driven(volts, steering, 4.0, np.zeros(7))
  assert begun(signals, -20)[3] == pytest.approx(signals[-20, 3], rel=0.003)


@pytest.mark.parametrize("layout", ["all-wheel", "rear", "front"])
def test_a_start_in_a_tight_turn_has_the_car_s_speed_not_its_driven_wheels_mean(layout):
  """Front wheels roll 1 / cos(0.45 rad), a ninth, faster than the car."""
  vehicle = dataclasses.replace(QCAR, layout=layout)
  signals = slow_turn(Twin(vehicle, [], threads=1, engine="reduced"))
  error = slipping(measured(signals, -20)[None], signals[[-20], PUSH], VALUES, vehicle)[0, 3] - signals[-20, 3]
  assert abs(error) < 0.01 * signals[-20, 3]
  if layout != "rear":
    assert TRAVEL * signals[-20, MOTOR] > 1.04 * signals[-20, 3]


@pytest.mark.parametrize("engine", ["reduced", "mujoco"])
@pytest.mark.parametrize(
  ("layout", "freedom"), [("all-wheel", 0.0), ("all-wheel", 0.1), ("all-wheel", 1.0), ("rear", 0.0)]
)
def test_a_stretch_that_begins_in_a_tight_turn_goes_on_as_the_car_did(engine, layout, freedom):
  """Wheels that began at the car's own speed made the motor jump by 10 rad/s in the first period."""
  vehicle = dataclasses.replace(QCAR, layout=layout, centre_differential=freedom)
  twin = Twin(vehicle, [], threads=1, engine=engine)
  signals, at = slow_turn(twin), -40
  segments = Segments(
    commands=np.tile([0.8, 0.45], (1, 30, 1)),
    start=measured(signals, at, vehicle)[None],
    steps=np.array([30]),
    period=PERIOD,
    recording=("turn",),
    offset=np.array([2.0]),
    start_rate=np.zeros((1, 7)),
    start_push=signals[[at], PUSH],
  )
  again = twin.simulate(twin.parameters.nominal[None], segments)[0, 0]
  np.testing.assert_allclose(again[1:, MOTOR], signals[at + 1 : at + 31, MOTOR], atol=0.01 * signals[at, MOTOR])


def test_wheels_that_roll_turn_as_their_places_move_along_their_headings():
  """About a point on the rear axle's line each moves as far as it is from there, with full Ackermann geometry."""
  values = quantities(TWIN.parameters.nominal[None], TWIN.base, QCAR) | {"ackermann_fraction": np.ones(1)}
  vehicle, radius, rate = dataclasses.replace(QCAR, centre_differential=1.0), 2.0, 0.5
  values["centre_differential"] = np.ones(1)
  angle = np.arctan(QCAR.wheelbase / radius)
  start = np.array([[0.0, 0.0, 0.0, radius * rate, QCAR.cg_to_rear * rate, rate, angle]])
  places = QCAR.wheel_positions[:, :2] - [-QCAR.cg_to_rear, radius]
  turns = turning(start, None, values, vehicle)[0]
  np.testing.assert_allclose(QCAR.wheel_radius * turns[:4], rate * np.hypot(*places.T), rtol=2e-3)
  assert turns[4] * QCAR.gear_ratio == pytest.approx(turns[:4].mean())


def test_a_car_whose_wheels_spin_begins_with_its_motor_s_speed():
  values, start = quantities(TWIN.parameters.nominal[None], TWIN.base, QCAR), np.zeros((1, 7))
  start[0, 3] = 1.0
  turns = turning(start, np.array([1.5]), values, QCAR)[0]
  np.testing.assert_allclose(turns[:4] * QCAR.wheel_radius, 1.5)
  assert turns[4] * TRAVEL == pytest.approx(1.5)
  rear = dataclasses.replace(QCAR, layout="rear")
  np.testing.assert_allclose(turning(start, np.array([1.5]), values, rear)[0, :4] * QCAR.wheel_radius, [1, 1, 1.5, 1.5])


def test_a_start_without_an_accelerometer_slips_as_its_wheels_gain_speed():
  start, rate = np.zeros((1, 7)), np.zeros((1, 7))
  start[0, 3], rate[0, 3] = 1.0, 3.0
  begin = lambda push: TWIN._as_measured(TWIN.parameters.nominal[None], SENSED, start.copy(), rate, push)[0][0, 3]
  assert begin(np.array([np.nan])) == begin(None) == begin(np.array([3.0])) < 0.99
  assert begin(np.zeros(1)) == 1.0


def test_a_speed_of_the_pose_is_the_car_s_and_its_wheels_turn_faster_by_their_slip():
  start, rate, push, nominal = np.zeros((1, 7)), np.zeros((1, 7)), np.array([3.0]), TWIN.parameters.nominal[None]
  start[0, 3] = 1.0
  by_pose = SENSED.copy()
  by_pose[0, 3] = True
  state, wheels = TWIN._as_measured(nominal, by_pose, start.copy(), rate, push)
  assert state[0, 3] == 1.0 and wheels is not None and wheels[0] > 1.01
  start[0, 3] = wheels[0]  # as an encoder says it: the same start
  sensed, rim = TWIN._as_measured(nominal, SENSED, start, rate, push)
  assert sensed[0, 3] == pytest.approx(1.0, abs=1e-4) and rim is not None and rim[0] == wheels[0]


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_speed_that_is_by_a_share_the_car_s_own_begins_there(share):
  """As logged it is that share of the car's speed and the rest of its wheels', whose slip is what the push needs."""
  twin = Twin(QCAR, select(["ground_speed"]), threads=1, engine="reduced")
  theta = twin.parameters.nominal[None].copy()
  theta[0, twin.parameters.index("ground_speed")] = share
  start = np.zeros((1, 7))
  start[0, 3] = 1.0
  state, wheels = twin._as_measured(theta, SENSED, start, np.zeros((1, 7)), np.array([3.0]))
  assert wheels is not None and wheels[0] > 1.003 and state[0, 3] < wheels[0] - 0.008
  assert share * state[0, 3] + (1.0 - share) * wheels[0] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(("mechanism", "value"), [("encoder_latency", 0.02), ("pose_latency", 0.02)])
@pytest.mark.parametrize("by_pose", [False, True])
def test_a_start_is_as_old_as_what_said_it(mechanism, value, by_pose):
  twin = Twin(QCAR, select([mechanism]), threads=1, engine="reduced")
  theta = twin.parameters.nominal[None].copy()
  theta[0, twin.parameters.index(mechanism)] = value
  start, rate = np.zeros((1, 7)), np.zeros((1, 7))
  start[0, 3], rate[0, 3] = 1.0, 2.0
  said = np.full((1, 7), by_pose)
  caught_up = by_pose == (mechanism == "pose_latency")
  assert twin._begun(theta, said, start, rate)[0, 3] == pytest.approx(1.04 if caught_up else 1.0)


def test_a_wheel_of_another_radius_is_no_error_of_a_pose_s_speed():
  twin = Twin(QCAR, select(["wheel_radius_error"]), threads=1, engine="reduced")
  theta = twin.parameters.nominal[None].copy()
  theta[0, twin.parameters.index("wheel_radius_error")] = 0.02
  start = np.full((1, 7), 1.0)
  assert twin._begun(theta, ~SENSED, start.copy(), np.zeros((1, 7)))[0, 3] == 1.0
  assert twin._begun(theta, SENSED, start.copy(), np.zeros((1, 7)))[0, 3] == pytest.approx(1.02)


def test_a_wheel_of_another_radius_is_an_error_of_what_a_speed_has_of_the_wheels():
  twin = Twin(QCAR, select(["wheel_radius_error", "ground_speed"]), threads=1, engine="reduced")
  theta = twin.parameters.vector({"wheel_radius_error": 0.02, "ground_speed": 0.75})[None]
  start = np.full((1, 7), 1.0)
  assert twin._begun(theta, SENSED, start, np.zeros((1, 7)))[0, 3] == pytest.approx(1.005)


def test_a_car_that_stands_starts_at_rest():
  assert not slipping(np.zeros((1, 7)), np.ones(1), VALUES, QCAR).any()


def test_slip_is_bounded():
  start = np.zeros((1, 7))
  start[0, 3] = 1.0
  assert slipping(start, np.array([1e6]), VALUES, QCAR)[0, 3] == pytest.approx(0.8)
