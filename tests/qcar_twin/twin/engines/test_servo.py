"""The servo of both engines is the differential equation it names."""

import dataclasses
import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from qcar_twin.plant import SIGNALS, START, Segments
from qcar_twin.twin.engines.servo import transition
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

STEP, PERIODS = 0.2, 30


def angle(time: np.ndarray, lag: float, inertia: float) -> np.ndarray:
  """Of a step of the command: q tau^2 y'' + tau y' + y = u, by an integrator of its own."""
  slope = lambda _, y: (y[1], (STEP - y[0] - lag * y[1]) / (inertia * lag**2))
  return solve_ivp(slope, (0.0, time[-1]), (0.0, 0.0), t_eval=time, rtol=1e-9, atol=1e-12).y[0]


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
@pytest.mark.parametrize(("lag", "inertia"), [(0.03, 0.5), (0.03, 0.25), (0.06, 0.1)])
def test_a_step_is_answered_by_the_differential_equation(engine, lag, inertia):
  car = Twin(QCAR, substeps=2, threads=1, engine=engine)
  commands = np.tile([0.0, STEP], (1, PERIODS, 1))
  segments = Segments(commands, np.zeros((1, len(START))), np.array([PERIODS]), 0.01, ("step",), np.zeros(1))
  theta = car.parameters.vector({"servo_time_constant": lag, "servo_inertia": inertia})
  shown = car.rollout(theta, segments).signals[0, 0, :, SIGNALS.index("steering_angle")]
  expected = angle(0.01 * np.arange(PERIODS + 1), lag, inertia)
  assert np.abs(shown - expected).max() < 1e-3 * STEP


def limited(time: np.ndarray, lag: float, inertia: float, rate: float) -> np.ndarray:
  """The same of a servo whose motor turns no faster than `rate`, in steps of 10 microseconds."""
  fine, h = [0.0], 1e-5
  speed = 0.0
  for _ in range(round(time[-1] / h)):
    if inertia > 0.0:
      speed += h * (STEP - fine[-1] - lag * speed) / (inertia * lag**2)
    else:
      speed = (STEP - fine[-1]) / lag
    speed = min(max(speed, -rate), rate)
    fine.append(fine[-1] + h * speed)
  return np.interp(time, h * np.arange(len(fine)), fine)


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
@pytest.mark.parametrize("stated", ["vehicle", "mechanism"])
@pytest.mark.parametrize(("lag", "inertia"), [(0.02, 0.0), (0.02, 0.3)])
def test_a_servo_turns_no_faster_than_its_limit_and_meets_its_goal_by_its_lag(engine, stated, lag, inertia):
  vehicle = dataclasses.replace(QCAR, servo_rate=4.0) if stated == "vehicle" else QCAR
  car = Twin(vehicle, [catalogue()["steering_rate_limit"]], substeps=5, threads=1, engine=engine)
  own = {"steering_inverse_rate": 0.25} if stated == "mechanism" else {}
  theta = car.parameters.vector({"servo_time_constant": lag, "servo_inertia": inertia} | own)
  commands = np.tile([0.0, STEP], (1, PERIODS, 1))
  segments = Segments(commands, np.zeros((1, len(START))), np.array([PERIODS]), 0.01, ("step",), np.zeros(1))
  shown = car.rollout(theta, segments).signals[0, 0, :, SIGNALS.index("steering_angle")]
  expected = limited(0.01 * np.arange(PERIODS + 1), lag, inertia, 4.0)
  assert shown[2] - shown[1] == pytest.approx(0.04, abs=0.0005)  # 4 rad/s for 10 ms
  assert np.abs(shown - expected).max() < 0.012 * STEP


def test_first_order_is_the_limit():
  lag, step = np.array([0.02, 0.02]), 0.005
  limit = transition(lag, np.array([0.0, 1e-5]), step)
  assert limit[0, 0] == np.exp(-step / 0.02) and not limit[1:, 0].any()
  assert limit[0, 1] == pytest.approx(limit[0, 0], rel=1e-3)


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_a_copy_made_while_the_servo_moves_goes_on_as_the_car_does(engine):
  car = Twin(QCAR, substeps=2, threads=1, engine=engine)
  theta = car.parameters.vector({"servo_time_constant": 0.03, "servo_inertia": 0.5})
  cars = car.begin(theta[None], np.zeros((1, len(START))))
  step = np.array([[0.0, STEP]])
  for _ in range(3):
    cars.step(step)
  copy = pickle.loads(pickle.dumps(cars))
  np.testing.assert_array_equal(cars.step(step), copy.step(step))


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
@pytest.mark.parametrize(
  "late",
  [
    {"steering_delay": 0.003},
    {"steering_delay": 0.0065},
    {"command_delay": 0.017},
    {"command_delay": 0.016, "steering_delay": 0.0085},  # parts that are more than a period together
  ],
  ids=lambda late: "+".join(f"{seconds:g}" for seconds in late.values()),
)
@pytest.mark.parametrize("rate", [4.0, np.inf])
def test_a_servo_is_as_late_as_its_command_whatever_limits_it(engine, late, rate):
  """A mean of two commands sends a servo of limited rate off at once, at its full rate, for a part of the step."""
  vehicle = dataclasses.replace(QCAR, servo_rate=rate)
  car = Twin(vehicle, [catalogue()[name] for name in late], substeps=5, threads=1, engine=engine)
  theta = car.parameters.vector({"servo_time_constant": 0.02, "servo_inertia": 0.0} | late)
  commands = np.zeros((1, PERIODS, 2))
  commands[0, 5:, 1] = STEP
  segments = Segments(commands, np.zeros((1, len(START))), np.array([PERIODS]), 0.01, ("step",), np.zeros(1))
  shown = car.rollout(theta, segments).signals[0, 0, :, SIGNALS.index("steering_angle")]
  fine = 1e-4 * np.arange(round(100 * PERIODS) + 1)
  answer = limited(fine, 0.02, 0.0, rate)
  expected = np.interp(0.01 * np.arange(PERIODS + 1) - 0.05 - sum(late.values()), fine, answer, left=0.0)
  assert np.abs(shown - expected).max() < 0.015 * STEP
