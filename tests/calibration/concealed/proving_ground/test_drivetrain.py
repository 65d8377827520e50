"""Cars of the proving ground with other axles driven and a VESC before the motor."""

import dataclasses

import numpy as np
import pytest

from calibration.concealed.proving_ground.car import Car, fleet
from calibration.concealed.proving_ground.drivetrain import Drivetrain
from calibration.concealed.proving_ground.simulation import Simulation

PLAIN = Car(copper=0.0, discharge=0.0)
SPEED = Drivetrain("rear", "speed", 11.1, 30.0, 0.2, 2.0, 250.0)


def driven(car: Car, commands: np.ndarray, speed: float = 0.0) -> np.ndarray:
  """Trace (rows, 11) of one car under commands (T, 2)."""
  sim = Simulation(fleet([car], [1]))
  start = np.zeros((1, 7))
  start[0, 3] = speed
  sim.begin(start, ticks=len(commands))
  for command in commands:
    sim.advance(command[:, None])
  return sim.trace[:, :, 0]


def held(command: float, ticks: int, steering: float = 0.0) -> np.ndarray:
  return np.tile([command, steering], (ticks, 1))


def train(**changes) -> Car:
  return dataclasses.replace(PLAIN, drivetrain=dataclasses.replace(Drivetrain(), **changes))


def test_a_duty_is_a_share_of_the_pack():
  volts, duty = driven(PLAIN, held(2.0, 40)), driven(train(command="duty", supply=10.0), held(0.2, 40))
  np.testing.assert_allclose(duty, volts, rtol=1e-9, atol=1e-12)


def test_a_current_is_a_torque():
  car = dataclasses.replace(train(command="current"), motor_coulomb=0.0, rolling_resistance=0.0)
  motor = driven(car, held(5.0, 40))[:, 8]
  gained = (motor[200] - motor[100]) / 0.2  # 2 ms a row
  assert gained == pytest.approx(car.motor_constant * 5.0 / car.inertia, rel=0.03)


def test_no_current_flows_that_the_pack_can_not_drive_against_the_back_emf():
  car = train(command="current", supply=1.0)
  sim, start = Simulation(fleet([car], [1])), np.zeros((1, 7))
  start[0, 3] = 0.9
  sim.begin(start)
  sim.advance(np.array([[8.0], [0.0]]))
  d = sim.dynamics
  assert d.current == pytest.approx((1.0 - d.constant * d.state.motor) / d.resistance, rel=0.02) and d.current < 2.0


def test_the_speed_loop_ends_where_it_was_told_to_in_spite_of_friction():
  motor = driven(dataclasses.replace(PLAIN, drivetrain=SPEED), held(1.2, 150))[:, 8]
  assert motor[-1] == pytest.approx(250.0 * 1.2, rel=2e-3)


def test_the_current_limit_bounds_the_acceleration():
  car = dataclasses.replace(PLAIN, drivetrain=dataclasses.replace(SPEED, max_current=8.0, supply=30.0))
  motor = driven(car, held(3.0, 30))[:, 8]
  line = car.linearised()
  assert (motor[100] - motor[50]) / 0.1 == pytest.approx(8.0 * car.motor_constant / car.inertia - line["P3"], rel=0.1)


@pytest.mark.parametrize(("layout", "free"), [("rear", slice(0, 2)), ("front", slice(2, 4))])
def test_the_wheels_of_an_axle_that_is_not_driven_pull_nothing(layout: str, free: slice):
  sim = Simulation(fleet([dataclasses.replace(train(layout=layout), rolling_resistance=0.0)], [1]))
  sim.begin(np.zeros((1, 7)))
  for _ in range(25):
    sim.advance(np.array([[2.0], [0.0]]))
  pull = sim.dynamics.force[0, :, 0]
  driving = np.delete(pull, np.r_[free])
  assert np.abs(pull[free]).max() < 0.05 * driving.min() and driving.min() > 0.2


def test_the_vehicle_table_says_how_the_car_is_driven():
  car = Car.draw_f1tenth(np.random.default_rng(0), "rear", "speed")
  table, std = car.measured(np.random.default_rng(1))
  assert (table["layout"], table["drive"]) == ("rear", "speed") and table["max_current"] == car.drivetrain.max_current
  assert not {"layout", "drive", "supply_voltage"} & set(PLAIN.measured(np.random.default_rng(1))[0])


def test_an_unknown_drivetrain_is_refused_with_the_known_ones():
  with pytest.raises(ValueError, match="all-wheel, front, rear.*'4wd'"):
    Drivetrain("4wd")
