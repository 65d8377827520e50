"""The independent car against what is known exactly: rest, mirror images, energy, the method's order, linear theory."""

import dataclasses

import numpy as np
import pytest

from calibration.concealed.proving_ground.car import GRAVITY, Car, fleet, static_loads
from calibration.concealed.proving_ground.dynamics import ROW, STATES, Dynamics, rolling_start

PLAIN = Car(copper=0.0, discharge=0.0, imu_x=0.0, imu_y=0.0)


def at_rest(cars: list[Car]) -> Dynamics:
  dynamics = Dynamics(fleet(cars, [1] * len(cars)))
  rolling_start(dynamics, np.zeros((len(cars), 7)))
  return dynamics


def rolling(cars: list[Car], speed: float) -> Dynamics:
  dynamics = Dynamics(fleet(cars, [1] * len(cars)))
  start = np.zeros((len(cars), 7))
  start[:, 3] = speed
  rolling_start(dynamics, start)
  return dynamics


def kinetic_energy(dynamics: Dynamics) -> np.ndarray:
  """Energy of motion and in the springs (N,) [J]; the brush is counted at its linear stiffness."""
  s, car = dynamics.state, dynamics.car
  body = car.mass * (s.vx**2 + s.vy**2) + car.yaw_inertia * s.yaw_rate**2
  turning = (car.wheel_inertia * s.wheel**2).sum(axis=0) + car.motor_inertia * s.motor**2
  stored = (car.shaft_stiffness * s.twist**2).sum(axis=0) + (dynamics.stiffness * s.carcass**2).sum(axis=(0, 1))
  return 0.5 * (body + turning + stored)


def run(dynamics: Dynamics, seconds: float, h: float = 1e-3) -> None:
  for _ in range(round(seconds / h)):
    dynamics.step(h)


def hold_speed(dynamics: Dynamics, speed: float, seconds: float) -> None:
  """A force on the body holds the speed without using the tyres."""
  wrench = dynamics.noise_wrench
  dynamics.conduct[:] = 0.0
  for _ in range(round(seconds / 1e-3)):
    wrench[0] += 1.0 * (speed - dynamics.state.vx)
    wrench[0] = np.clip(wrench[0], -10, 10)
    dynamics.step(1e-3)


def test_a_car_at_rest_stays_exactly_at_rest():
  dynamics = at_rest([Car.draw(np.random.default_rng(seed)) for seed in range(5)])
  run(dynamics, 1.0)
  assert np.all(dynamics.state.array == 0.0)


def test_wheels_roll_where_they_are_at_a_start_in_a_turn():
  dynamics = Dynamics(fleet([PLAIN], [1]))
  yaw_rate = 1.5 * np.tan(0.35) / (PLAIN.cg_to_front + PLAIN.cg_to_rear)
  rolling_start(dynamics, np.array([[0, 0, 0.4, 1.5, yaw_rate * PLAIN.cg_to_rear, yaw_rate, 0.35]]))
  dynamics.stage.array[:] = dynamics.state.array
  dynamics.derivative()
  assert np.abs(dynamics.slide[0]).max() < 1e-12
  assert dynamics.state.wheel[:2].mean() > 1.05 * dynamics.state.wheel[2:].mean()


def test_every_state_has_its_own_row():
  assert len(set(STATES)) == len(STATES) == 29
  assert [ROW[name] for name in ("x", "vx", "wheel_fl", "ux_fl", "servo", "motor_angle")] == [0, 3, 10, 17, 25, 28]


def test_named_groups_are_views_of_the_rows():
  state = at_rest([PLAIN]).state
  state.array[:, 0] = np.arange(29)
  assert state.wheel[:, 0].tolist() == [10, 11, 12, 13]
  assert state.twist[:, 0].tolist() == [15, 16]
  assert state.carcass[:, :, 0].tolist() == [[17, 18, 19, 20], [21, 22, 23, 24]]
  assert (state.left[:, 0].tolist(), state.right[:, 0].tolist()) == ([10, 12], [11, 13])
  assert state.tilt[:, 0].tolist() == [6, 7]


def test_static_loads_carry_the_weight_and_no_moment():
  car = fleet([dataclasses.replace(PLAIN, cg_to_front=0.11, cg_to_rear=0.15, cg_lateral=0.01)], [1])
  load = static_loads(car)[:, 0]
  assert load.sum() == pytest.approx(2.7 * GRAVITY)
  assert (load[0] + load[1]) * 0.11 == pytest.approx((load[2] + load[3]) * 0.15)
  left, right = load[0] + load[2], load[1] + load[3]
  assert left * (0.085 - 0.01) == pytest.approx(right * (0.085 + 0.01))


@pytest.mark.parametrize("angle", [0.0, 0.2])
def test_coasting_with_open_circuit_only_loses_energy(angle):
  dynamics = rolling([PLAIN], 2.0)
  dynamics.conduct[:] = 0.0
  dynamics.steer_target[:] = angle
  run(dynamics, 0.3)  # the servo does work while it turns the wheels
  before = kinetic_energy(dynamics)[0]
  for _ in range(60):
    run(dynamics, 0.02)
    now = kinetic_energy(dynamics)[0]
    assert now <= before * (1 + 1e-6)
    before = now
  assert before > 0


@pytest.mark.slow
def test_a_coasting_car_comes_to_rest_and_stays():
  dynamics = rolling([PLAIN], 0.5)
  run(dynamics, 4.0)
  assert abs(dynamics.state.vx[0]) < 1e-4
  place = dynamics.state.x[0]
  run(dynamics, 1.0)
  assert abs(dynamics.state.x[0] - place) < 2e-5


def test_the_brakes_of_a_shorted_motor_hold_the_car_on_a_slope():
  dynamics = at_rest([PLAIN])
  dynamics.gravity[0] = -0.15
  run(dynamics, 1.0)
  place = dynamics.state.x[0]
  run(dynamics, 1.0)
  assert abs(dynamics.state.x[0] - place) < 3e-4


def test_energy_in_equals_energy_out_on_the_flat():
  """Electrical power into the rotor minus what friction takes is the gain in kinetic energy."""
  car = dataclasses.replace(PLAIN, rolling_resistance=0.0, motor_coulomb=0.0, motor_viscous=0.0)
  dynamics, work, h = at_rest([car]), 0.0, 1e-3
  dynamics.voltage[:] = 1.0
  for _ in range(1500):
    power = car.motor_constant * dynamics.current[0] * dynamics.state.motor[0]
    slide = (dynamics.force * dynamics.slide).sum()
    dynamics.step(h)
    work += h * (power - slide)
  assert kinetic_energy(dynamics)[0] == pytest.approx(work, rel=0.02)


def test_mirrored_steering_gives_mirrored_motion():
  dynamics = rolling([PLAIN, PLAIN], 1.5)
  dynamics.voltage[:] = 2.0
  dynamics.steer_target[:] = [0.25, -0.25]
  run(dynamics, 1.0)
  s = dynamics.state
  for name in ("y", "yaw", "vy", "yaw_rate", "roll", "servo"):
    value = getattr(s, name)
    assert value[0] == pytest.approx(-value[1], rel=1e-9, abs=1e-12)
  for name in ("x", "vx", "motor", "pitch"):
    value = getattr(s, name)
    assert value[0] == pytest.approx(value[1], rel=1e-9)
  assert s.wheel_fl[0] == pytest.approx(s.wheel_fr[1], rel=1e-9)


def test_reversed_voltage_gives_reversed_motion_of_a_symmetric_car():
  car = dataclasses.replace(PLAIN, roll_front=0.5)
  dynamics = at_rest([car, car])
  dynamics.voltage[:] = [1.5, -1.5]
  run(dynamics, 1.0)
  assert dynamics.state.vx[0] == pytest.approx(-dynamics.state.vx[1], rel=1e-9)


@pytest.mark.slow
def test_runge_kutta_converges_with_fourth_order():
  """Halving the step divides the error by sixteen while the brush stays on its polynomial branch."""
  ends = []
  for h in (5e-4, 2.5e-4, 1.25e-4, 3.125e-5):
    dynamics = rolling([PLAIN], 1.5)
    dynamics.voltage[:] = 1.8
    dynamics.steer_target[:] = 0.05
    run(dynamics, 0.1, h)
    ends.append(dynamics.state.array[:6, 0].copy())
  errors = [np.linalg.norm(end - ends[-1]) for end in ends[:-1]]
  assert errors[0] / errors[1] > 11
  assert errors[1] / errors[2] > 11


def test_cars_side_by_side_do_not_disturb_each_other():
  cars = [Car.draw(np.random.default_rng(seed)) for seed in range(7)]
  together, alone = at_rest(cars), at_rest(cars[3:4])
  for dynamics in (together, alone):
    dynamics.voltage[:] = 1.7
    dynamics.steer_target[:] = 0.1
    run(dynamics, 0.5)
  assert np.array_equal(together.state.array[:, 3], alone.state.array[:, 0])


@pytest.mark.slow
def test_steady_speeds_follow_p1_p2_p3():
  cars = [dataclasses.replace(Car.draw(np.random.default_rng(seed)), copper=0.0, discharge=0.0) for seed in range(4)]
  volts = np.array([0.75, 1.25, 1.5, 2.0, 2.5])
  dynamics = at_rest([car for car in cars for _ in volts])
  dynamics.voltage[:] = np.tile(volts, len(cars))
  run(dynamics, 5.0)
  for car, speed in zip(cars, dynamics.state.motor.reshape(len(cars), -1), strict=True):
    line = car.linearised()
    expected = (line["P1"] * volts - line["P3"]) / line["P2"]
    assert speed == pytest.approx(expected, rel=0.004 + 2 * np.exp(-line["P2"] * 5.0))


def test_the_speed_step_has_the_time_constant_of_p2():
  line, dynamics = PLAIN.linearised(), at_rest([PLAIN])
  dynamics.voltage[:] = 1.0
  run(dynamics, 0.2)
  first = dynamics.state.motor[0]
  run(dynamics, 0.5)
  end = (line["P1"] - line["P3"]) / line["P2"]
  rate = -np.log((end - dynamics.state.motor[0]) / (end - first)) / 0.5
  assert rate == pytest.approx(line["P2"], rel=0.02)


def test_axle_forces_over_slip_angles_are_the_cornering_stiffnesses():
  free = {"motor_coulomb": 0.0, "motor_viscous": 0.0, "rolling_resistance": 0.0}  # the tyres carry no drag
  cars = [dataclasses.replace(Car.draw(np.random.default_rng(seed)), **free) for seed in range(4)]
  dynamics = rolling(cars, 1.5)
  dynamics.steer_target[:] = 0.02
  hold_speed(dynamics, 1.5, 2.0)
  s, car, force = dynamics.state, dynamics.car, dynamics.force[1]
  front = s.servo - (s.vy + car.cg_to_front * s.yaw_rate) / s.vx
  rear = -(s.vy - car.cg_to_rear * s.yaw_rate) / s.vx
  assert (force[0] + force[1]) / front == pytest.approx(
    [c.linearised()["cornering_stiffness_front"] for c in cars], rel=0.01
  )
  assert (force[2] + force[3]) / rear == pytest.approx(
    [c.linearised()["cornering_stiffness_rear"] for c in cars], rel=0.01
  )


def test_the_steady_turn_is_the_one_of_the_single_track_model():
  line, speed, angle = PLAIN.linearised(), 1.2, 0.02
  dynamics = rolling([PLAIN], speed)
  dynamics.steer_target[:] = angle
  hold_speed(dynamics, speed, 3.0)
  length = PLAIN.wheelbase
  front, rear = line["cornering_stiffness_front"], line["cornering_stiffness_rear"]
  gradient = PLAIN.mass / length * (PLAIN.cg_to_rear / front - PLAIN.cg_to_front / rear)
  assert dynamics.state.yaw_rate[0] == pytest.approx(speed * angle / (length + gradient * speed**2), rel=0.02)


def test_forces_never_exceed_friction():
  dynamics = rolling([PLAIN], 2.0)
  dynamics.steer_target[:] = 0.5
  dynamics.voltage[:] = 4.0
  for _ in range(100):
    run(dynamics, 0.005)
    force = np.hypot(*dynamics.force)
    q = dynamics.load * dynamics.inverse_nominal
    peak = PLAIN.friction * dynamics.load * (1 + PLAIN.friction_load * (1 - q))
    assert np.all(force <= peak * (1 + 1e-9))


def test_the_carcass_delays_the_force_by_its_relaxation_length():
  """Side force of a suddenly steered rolling car rises with the way rolled, more slowly for a softer carcass."""
  for length, tolerance in ((0.02, 0.06), (0.06, 0.04)):
    heavy = {"mass": 200.0, "yaw_inertia": 20.0, "friction": 9.0, "servo_rate": 900.0}
    dynamics = rolling([dataclasses.replace(PLAIN, relaxation=length, carcass_damping=0.0, **heavy)], 1.0)
    dynamics.steer_target[:] = 0.02
    run(dynamics, 0.02)
    share = dynamics.force[1, :2].sum() / (2 * PLAIN.cornering_front * 0.02)
    rolled = 0.02 - 2 * PLAIN.servo_damping / 900.0
    assert share == pytest.approx(1 - np.exp(-rolled / length), abs=tolerance)


def test_the_servo_lags_by_twice_damping_over_frequency():
  dynamics, lag = at_rest([PLAIN]), 0.0
  dynamics.steer_target[:] = 0.1
  for _ in range(200):
    lag += 1e-3 * (1 - dynamics.state.servo[0] / 0.1)
    run(dynamics, 1e-3)
  assert lag == pytest.approx(2 * PLAIN.servo_damping / PLAIN.servo_rate, abs=6e-4)


def test_open_differentials_let_the_outer_wheels_turn_faster():
  dynamics = rolling([PLAIN], 0.6)
  dynamics.steer_target[:] = 0.3
  dynamics.voltage[:] = 0.9
  run(dynamics, 2.0)
  s = dynamics.state
  radius = s.vx[0] / s.yaw_rate[0]
  expected = (radius + PLAIN.track_width / 2) / (radius - PLAIN.track_width / 2)
  assert s.wheel_rr[0] / s.wheel_rl[0] == pytest.approx(expected, rel=0.02)


def test_load_moves_outwards_in_a_turn_and_backwards_under_power():
  dynamics = rolling([PLAIN], 1.5)
  dynamics.steer_target[:] = 0.15
  hold_speed(dynamics, 1.5, 1.0)
  left, right = dynamics.load[0::2, 0].sum(), dynamics.load[1::2, 0].sum()
  moved = PLAIN.mass * dynamics.acceleration[1, 0] * PLAIN.cg_height / PLAIN.track_width
  assert (right - left) / 2 == pytest.approx(moved, rel=0.03)
  dynamics = at_rest([PLAIN])
  dynamics.voltage[:] = 2.0
  run(dynamics, 0.25)
  assert dynamics.load[2:, 0].sum() > dynamics.load[:2, 0].sum() + 0.5


def test_play_in_the_shafts_lets_the_motor_turn_before_the_wheels():
  cars = [PLAIN, dataclasses.replace(PLAIN, shaft_play=0.05)]
  dynamics = at_rest(cars)
  dynamics.voltage[:] = 1.0
  run(dynamics, 0.01)
  assert dynamics.state.wheel[:, 1].max() < 0.2 * dynamics.state.wheel[:, 0].max()
  assert dynamics.state.motor[1] > 1.5 * dynamics.state.motor[0]


def test_play_of_one_car_leaves_its_neighbour_alone():
  worn = dataclasses.replace(PLAIN, shaft_play=0.05)
  pair, alone = at_rest([PLAIN, worn]), at_rest([PLAIN])
  for dynamics in (pair, alone):
    dynamics.voltage[:] = 1.0
    run(dynamics, 0.3)
  assert np.array_equal(pair.state.array[:, 0], alone.state.array[:, 0])
