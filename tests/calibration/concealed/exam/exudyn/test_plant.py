"""The rigid-body car obeys what any car obeys: static loads, Newton, the circle its wheels point to, dry friction."""

import numpy as np
import pytest

from calibration.concealed.exam.exudyn.car import GEAR, ExudynCar
from calibration.concealed.exam.exudyn.machine import HINGES, left_and_right
from calibration.concealed.exam.exudyn.numbers import GRAVITY, HALF_TRACK
from calibration.concealed.exam.exudyn.plant import STEPS, ExudynPlant
from calibration.concealed.exam.generator import FINE, Start

pytest.importorskip("exudyn", reason="Exudyn is not installed (extra `exam`)")


@pytest.fixture
def car():
  return ExudynCar(np.random.default_rng(3))


def held(car, speed, steer, seconds):
  """Trace (M, 10) of a car whose speed is held by its motor, and its plant."""
  plant, (per_speed, to_move, answer) = car.plant(), car.drive_line()
  rows = [plant.start(Start(0.0, 0.0, 0.0, speed))[None]]
  for _ in range(round(100 * seconds)):
    drive = per_speed * speed + to_move + answer * (speed - rows[-1][-1, 3])
    rows.append(plant.advance(drive, steer))
  return np.concatenate(rows), plant


def forces(plant):
  """Side force to the left, force forward and load of each wheel (4, 3), seen along the wheel."""
  local = plant.machine.exudyn.OutputVariableType.ForceLocal
  return np.array([plant.machine.system.GetObjectOutput(disc, local) for disc in plant.machine.discs])


def test_the_floor_carries_the_weight_as_levers_say(car):
  n, plant = car.numbers, car.plant()
  first = plant.start(Start(1.0, 2.0, 0.3, 0.0))
  assert first[:4] == pytest.approx([1.0, 2.0, 0.3, 0.0])
  trace = np.concatenate([plant.advance(0.0, 0.0) for _ in range(30)])
  assert np.abs(trace[:, [3, 4, 5, 8]]).max() < 1e-3, "it stands still"
  assert np.ptp(trace[:, 6:8], axis=0).max() < 1e-3, "and does not swing"
  front, rear = (0.5 * n.mass * GRAVITY * lever / (n.ahead + n.behind) for lever in (n.behind, n.ahead))
  assert forces(plant)[:, 2] == pytest.approx([front, front, rear, rear], rel=1e-3)


def test_a_straight_run_obeys_newton(car):
  n, plant = car.numbers, car.plant()
  plant.start(Start(0.0, 0.0, 0.0, 1.0))
  trace = np.concatenate([plant.advance(10.0, 0.0) for _ in range(60)])
  spin = trace[-1, 3] / n.radius
  driving = 10.0 * n.per_ampere - 4.0 * (n.dry + n.fading * spin)
  moved = n.mass + 4.0 * n.wheel_spin / n.radius**2
  assert np.polyfit(np.arange(200) * 1e-3, trace[-200:, 3], 1)[0] == pytest.approx(driving / n.radius / moved, rel=0.01)
  assert np.abs(trace[:, [1, 2, 4, 5, 7]]).max() < 1e-9, "what drives straight ahead steers nowhere"
  assert trace[-1, 8] * GEAR * n.radius > trace[-1, 3], "driven wheels slide a little"


def test_a_slow_car_goes_round_where_its_wheels_point(car):
  trace, _ = held(car, 0.4, 0.3, 2.0)
  speed, yaw_rate, road = trace[-1, [3, 5, 9]]
  assert road == pytest.approx(0.3, abs=1e-4)
  n = car.numbers
  left, right = left_and_right(road, n.ahead + n.behind, HALF_TRACK)
  radius = 0.5 * ((n.ahead + n.behind) / np.tan(left) + (n.ahead + n.behind) / np.tan(right))
  assert speed / yaw_rate == pytest.approx(radius, rel=0.02)
  swing = trace[-500:, 5]
  assert np.std(np.diff(swing)) < 1e-5, "its yaw rate has no ripple"


def test_in_a_turn_the_wheels_forces_make_the_motion(car):
  trace, plant = held(car, 1.8, 0.2, 1.5)
  side, forward, load = forces(plant).T
  angles = np.array([plant.machine.system.systemData.GetODE2Coordinates()[h] for h in HINGES] + [0.0, 0.0])
  across = (side * np.cos(angles) + forward * np.sin(angles)).sum()
  n, speed, yaw_rate = car.numbers, trace[-1, 3], trace[-1, 5]
  assert across == pytest.approx(n.mass * speed * yaw_rate, rel=0.02)
  lifted = 0.5 * (load[1] + load[3] - load[0] - load[2])
  tipping = n.mass * speed * yaw_rate * n.height + 4.0 * n.wheel_spin * speed / n.radius * yaw_rate  # and their spin
  assert lifted == pytest.approx(tipping / (2.0 * HALF_TRACK), rel=0.02)
  assert load.sum() == pytest.approx(n.mass * GRAVITY, rel=1e-3)


def test_friction_is_never_more_than_its_share_of_the_load(car):
  plant = car.plant()
  plant.start(Start(0.0, 0.0, 0.0, 2.5))
  used = []
  for tick in range(80):
    plant.advance(40.0 if tick < 40 else -40.0, 0.45)
    side, forward, load = forces(plant)[forces(plant)[:, 2] > 0.1].T
    used.extend(np.hypot(side, forward) / load)
  grip = car.numbers.grip_left
  assert np.max(used) < grip * (1.0 + 1e-6) and np.max(used) > 0.95 * grip


def test_it_yields_by_a_sliding_speed_where_a_tyre_yields_by_an_angle(car):
  n, stiffness = car.numbers, []
  for speed, steer in ((0.9, 0.12), (1.8, 0.03)):  # the same side force
    trace, plant = held(car, speed, steer, 1.0)
    angle = (n.behind * trace[-1, 5] - trace[-1, 4]) / trace[-1, 3]
    stiffness.append(forces(plant)[2:, 0].sum() / angle)
  load = n.mass * GRAVITY * n.ahead / (n.ahead + n.behind)
  assert stiffness[1] == pytest.approx(2.0 * stiffness[0], rel=0.05), "twice the speed, twice as stiff"
  assert stiffness[1] == pytest.approx(2.0 * n.grip_left * load * 1.8 / n.zone_rear, rel=0.1)


def test_it_brakes_to_a_standstill_and_drives_backwards(car):
  plant = car.plant()
  plant.start(Start(0.0, 0.0, 0.0, 1.0))
  trace = np.concatenate([plant.advance(-8.0, 0.1) for _ in range(140)])
  assert trace[0, 3] > 0.9 and trace[-1, 3] < -0.3
  while plant.advance(6.0, 0.1)[-1, 3] < -0.1:
    pass
  rolled = np.concatenate([plant.advance(0.0, 0.1) for _ in range(150)])
  assert np.abs(rolled[-1, [3, 5]]).max() < 1e-3, "it rolls out and stands"


def test_it_turns_to_the_right_as_to_the_left(car):
  def driven(side):
    plant = car.plant()
    plant.start(Start(0.0, 0.0, 0.0, 1.8))
    return np.array([plant.advance(8.0, 0.2 * side * np.sin(0.2 * k))[-1] for k in range(60)])

  mirror = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
  left, right = driven(1.0), driven(-1.0)
  assert right == pytest.approx(mirror * left, abs=1e-6) and np.ptp(left[:, 5]) > 0.3


def test_the_servo_has_its_lag_its_rate_and_its_stops(car):
  numbers = car.numbers.copied()
  numbers.servo_rate = 4.0
  plant = ExudynPlant(numbers, GEAR)
  plant.start(Start(0.0, 0.0, 0.0, 1.0))
  trace = np.concatenate([plant.advance(0.0, 0.001 * k) for k in range(100)])
  assert trace[-1, 9] == pytest.approx(0.1 * (1.0 - 1.0 / FINE / 10.0) - 0.1 * numbers.servo, abs=6e-4), "a ramp"
  turned = np.concatenate([plant.advance(0.0, 1.0) for _ in range(40)])
  assert np.max(np.diff(turned[:, 9])) / 1e-3 == pytest.approx(4.0, rel=0.02)
  assert turned[-1, 9] == pytest.approx(numbers.travel, abs=0.03), "stops give way a little"


def test_no_step_of_a_session_reaches_the_servos_fastest(car):
  slow, fast = (car.numbers.copied() for _ in range(2))
  fast.servo_rate = 1e3
  first = [ExudynPlant(numbers, GEAR) for numbers in (slow, fast)]
  for plant in first:
    plant.start(Start(0.0, 0.0, 0.0, 0.8))
  one, other = (plant.advance(1.0, np.deg2rad(20.0)) for plant in first)
  assert np.array_equal(one, other)


def test_the_method_converges(car):
  def driven(steps):
    plant = ExudynPlant(car.numbers.copied(), GEAR, steps)
    rows = [plant.start(Start(0.0, 0.0, 0.0, 1.8))]
    for k in range(80):
      rows.append(plant.advance(9.0 * np.sign(np.sin(k / 12)), 0.25 * np.sin(k / 9))[-1])
    return np.array(rows)

  error, noise = np.sqrt(np.mean((driven(STEPS) - driven(5 * STEPS)) ** 2, axis=0)), car.noise
  assert np.all(error[5:9] < 0.1 * np.array([noise["gyro"], noise["accel"], noise["accel"], noise["motor"]])), error
  assert np.all(error[:3] < 0.1 * noise["pose"])


def test_the_same_run_is_the_same_bits(car):
  def driven():
    plant = car.plant()
    plant.start(Start(0.0, 0.0, 0.0, 1.2))
    return np.concatenate([plant.advance(7.0, 0.2 * np.sin(k)) for k in range(20)])

  assert np.array_equal(driven(), driven())


@pytest.mark.parametrize(
  ("name", "value"),
  [("mass", 1.0), ("radius", 0.0), ("grip_left", -0.1), ("travel", 1.2), ("left_share", 1.5), ("zone_rear", 0.01)],
)
def test_impossible_numbers_are_refused(car, name, value):
  numbers = car.numbers.copied()
  setattr(numbers, name, value)
  with pytest.raises(ValueError, match=f"no such car of Exudyn: .*{name}"):
    ExudynPlant(numbers, GEAR)


def test_a_car_that_turns_over_is_refused(car):
  numbers = car.numbers.copied()
  numbers.height *= 6.0
  plant = ExudynPlant(numbers, GEAR)
  plant.start(Start(0.0, 0.0, 0.0, 3.0))
  with pytest.raises(ValueError, match="turned over"):
    for _ in range(200):
      plant.advance(0.0, 0.45)


def test_what_the_owner_states_of_mass_and_inertia_is_what_moves(car):
  """On ice, a force and a yaw moment on the chassis, by the coordinates that the tree turns and moves about."""
  numbers = car.numbers.copied()
  numbers.grip_left = numbers.grip_right = 1e-6
  plant = ExudynPlant(numbers, GEAR)
  plant.start(Start(0.0, 0.0, 0.0, 0.0))
  plant.forces[2] = 0.1
  turned = plant.advance(0.0, 0.0)[-1, 5]
  assert turned == pytest.approx(0.1 * 0.01 / numbers.whole_yaw_inertia, rel=0.005), "front wheels lag in their servo"
  plant.start(Start(0.0, 0.0, 0.0, 2.0))
  plant.numbers.drag = 1.5
  slower = plant.advance(0.0, 0.0)[-1, 3]
  assert 2.0 - slower == pytest.approx(1.5 * 4.0 * 0.01 / numbers.mass, rel=0.02)
