"""The multi-body car keeps its dimensionless groups at any size, obeys Newton, and stands still on its springs."""

import numpy as np
import pytest

from calibration.concealed.exam.commonroad.car import CommonroadCar, CommonroadFullCar
from calibration.concealed.exam.commonroad.numbers import GRAVITY
from calibration.concealed.exam.commonroad.plant import CommonroadPlant
from calibration.concealed.exam.commonroad.scale import to_size
from calibration.concealed.exam.generator import FINE, Start

pytest.importorskip("vehiclemodels", reason="commonroad-vehicle-models is not installed (extra `exam`)")

SIZES = {"tenth": CommonroadCar, "full": CommonroadFullCar}


@pytest.fixture(params=SIZES)
def car(request):
  return SIZES[request.param](np.random.default_rng(3))


def test_a_small_car_moves_as_the_published_one():
  from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
  from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

  large, small = parameters_vehicle2(), parameters_vehicle2()
  large.E_f, large.I_xz_s = 0.3, 40.0  # 0 in the published set
  small.E_f, small.I_xz_s = 0.3, 40.0
  base = large.a + large.b
  to_size(small, 0.1 * base, 2.7)
  rng = np.random.default_rng(0)
  long, angle, fast, turn = 0.1, 1.0, 0.1**0.5, 0.1**-0.5
  unit = np.array([
    long, long, angle, fast, angle, turn, angle, turn, angle, turn, fast, long, fast, angle, turn, fast, long, fast,
    angle, turn, fast, long, fast, turn, turn, turn, turn, long, long,
  ])  # fmt: skip
  state = 0.01 * rng.standard_normal(29)
  state[[2, 3, 5]] = 0.1, 8.0, 0.5
  state[[16, 21]] = 0.017
  state[23:27] = 8.0 / large.R_w * (1.0 + 0.01 * rng.standard_normal(4))
  push = 1.3  # m/s^2, which has no length in it but g
  big = np.array(vehicle_dynamics_mb(list(state), [0.2, push], large))
  little = np.array(vehicle_dynamics_mb(list(unit * state), [0.2 * turn, push], small))
  assert little == pytest.approx(unit * turn * big, rel=1e-9, abs=1e-9)
  assert small.m == pytest.approx(2.7) and small.a + small.b == pytest.approx(0.1 * base)


def test_a_straight_run_obeys_newton(car):
  plant, n = car.plant(), car.numbers
  unit, amps = np.sqrt(car.size.length), car.size.amperes
  plant.start(Start(0.0, 0.0, 0.0, 1.5 * unit))
  trace = np.concatenate([plant.advance(8.0 * amps, 0.0) for _ in range(round(60 * unit))])
  spin = np.array(plant.state[23:27])
  wheels = n.car.I_y_w * (trace[-1, 6] / n.car.R_w) * 4.0 / n.car.R_w
  lost = (n.dry + n.fading * spin[2:].mean()) / n.car.R_w
  pulled = (n.car.m * np.gradient(trace[:, 3], 0.01 / FINE)[-50:-5]).mean()
  assert pulled == pytest.approx(8.0 * amps * n.per_ampere / n.car.R_w - lost - wheels, rel=0.02)
  assert spin[2:].min() * n.car.R_w > trace[-1, 3] > 0.999 * spin[:2].max() * n.car.R_w, "only driven wheels slip"
  assert np.abs(trace[:, [4, 5, 7]]).max() < 1e-9, "what drives straight ahead steers nowhere"


def test_it_turns_to_the_right_as_to_the_left(car):
  def driven(side):
    plant = car.plant()
    plant.start(Start(0.0, 0.0, 0.0, 1.8 * np.sqrt(car.size.length)))
    return np.array([plant.advance(8.0 * car.size.amperes, 0.1 * side * np.sin(0.2 * k))[-1] for k in range(50)])

  left, right = driven(1.0), driven(-1.0)
  mirror = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # x y yaw v_x v_y r a_x a_y motor steer
  assert right == pytest.approx(mirror * left, abs=1e-6 * np.abs(left).max()) and np.ptp(left[:, 5]) > 0.1


def test_wheels_slip_from_the_first_sample_on(car):
  plant = car.plant()
  first = plant.start(Start(0.0, 0.0, 0.0, 1.8 * np.sqrt(car.size.length)))
  after = plant.advance(0.0, 0.0)
  assert after[-1, 8] / first[8] == pytest.approx(after[-1, 3] / first[3], abs=1e-5), "their speed goes with the car's"


def test_it_stands_on_its_springs_and_a_turn_is_that_of_its_speed(car):
  plant, unit = car.plant(), np.sqrt(car.size.length)
  first = plant.start(Start(1.0, 2.0, 0.3, 1.5 * unit))
  assert first[:4] == pytest.approx([1.0, 2.0, 0.3, 1.5 * unit])
  straight = np.concatenate([plant.advance(0.0, 0.0) for _ in range(round(50 * unit))])
  assert np.ptp(straight[20:, 6]) < 0.05, "neither pitch nor heave swings"
  turning = np.concatenate([plant.advance(0.0, 0.1) for _ in range(round(120 * unit))])
  speed, yaw_rate, felt, road = turning[-1, [3, 5, 7, 9]]
  assert road == pytest.approx(0.1) and yaw_rate > 0.0
  felt_by_roll = felt - speed * yaw_rate
  assert felt_by_roll == pytest.approx(-GRAVITY * np.sin(plant.state[6]), abs=0.05)
  assert 0.02 < felt_by_roll / felt < 0.3, "the body leans out of the turn"


def test_the_method_converges(car):
  unit = np.sqrt(car.size.length)

  def driven(steps):
    plant = CommonroadPlant(car.numbers.copied(), 0.1, steps)
    rows = [plant.start(Start(0.0, 0.0, 0.0, 1.8 * unit))]
    for k in range(round(80 * unit)):
      push, steer = 6.0 * car.size.amperes * np.sign(np.sin(k / (12 * unit))), 0.15 * np.sin(k / (9 * unit))
      rows.append(plant.advance(push, steer)[-1])
    return np.array(rows)

  usual, fine = driven(car.size.steps), driven(8 * car.size.steps)
  error, noise = np.sqrt(np.mean((usual - fine) ** 2, axis=0)), car.noise
  assert np.all(error[5:9] < 0.6 * np.array([noise["gyro"], noise["accel"], noise["accel"], noise["motor"]])), error


def test_tyres_slip_where_they_touch_the_road(car):
  """A body that swings above axles which go straight ahead pulls them by its joints, and by no tyre."""
  from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

  plant, p = car.plant(), car.numbers.car
  plant.start(Start(0.0, 0.0, 0.0, 1.8 * np.sqrt(car.size.length)))
  swinging = list(plant.state)
  swinging[7], swinging[10] = 0.5, 0.5 * (p.h_s - swinging[11])  # roll rate, and the side speed that goes with it
  no_force = list(plant.rate(list(swinging), (0.0, 0.0), p))
  assert no_force[5] == pytest.approx(0.0, abs=1e-9), "nothing turns the car"
  assert abs(vehicle_dynamics_mb(list(swinging), (0.0, 0.0), p)[5]) > 1e-3, "the package's own tyres would"
  turning = list(plant.state)
  turning[5], turning[10], turning[15], turning[20] = 0.3, 0.02, 0.02 + 0.3 * p.a, 0.02 - 0.3 * p.b
  own = vehicle_dynamics_mb(list(turning), (0.1, 0.5), p)
  assert plant.rate(list(turning), (0.1, 0.5), p) == pytest.approx(own, rel=1e-12, abs=1e-12), "where it does not roll"
