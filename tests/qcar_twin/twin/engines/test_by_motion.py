"""What goes by a car's motion in a form that the reduced car knows: it drives whole runs without asking anybody."""

import numpy as np
import pytest

from qcar_twin.plant import START, Segments
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.mechanisms.motor_heating import MotorHeating
from qcar_twin.twin.mechanisms.quadratic_drag import QuadraticDrag
from qcar_twin.twin.simulation import Simulation
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

PERIODS = 300
TIME = 0.01 * np.arange(PERIODS)


@pytest.fixture(scope="module")
def mujoco_car() -> Twin:
  return Twin(Vehicle.load(), select(["quadratic_drag", "motor_heating", "steering_lag"]), substeps=2, threads=1)


@pytest.fixture(scope="module")
def reduced(mujoco_car) -> Twin:
  return mujoco_car.on("reduced")


def stretches(steps) -> Segments:
  """Starts, reversals and turns, of unlike length."""
  drive = np.stack([np.full(PERIODS, 2.0), 2.5 * np.sin(2.0 * TIME), np.where(TIME < 1.5, 2.0, 0.0)])
  commands = np.stack([drive, np.broadcast_to(0.2 * np.sin(3.0 * TIME), drive.shape)], axis=-1)
  names, rest = tuple("abc"), np.zeros((len(steps), len(START)))
  return Segments(commands, rest, np.array(steps), 0.01, names, np.zeros(len(steps)))


def test_what_an_engine_does_by_itself_is_what_it_is_told_in_every_period(reduced, monkeypatch):
  """Drag and a warm motor, alone and together, beside cars that have neither, and in stretches of unlike length."""
  at, theta = reduced.parameters.index, np.tile(reduced.parameters.nominal, (4, 1))
  theta[[1, 3], at("quadratic_drag")] = 0.3, 0.8
  theta[2:, at("motor_heating")], theta[3, at("motor_heating_magnets")] = 0.2, 0.1
  theta[:, at("motor_heating_time")] = 5.0
  theta[1:3, at("steering_lag")] = 0.05
  segments, asked = stretches([60, 200, PERIODS]), []
  for kind in (QuadraticDrag, MotorHeating):
    hook = "wrench" if kind is QuadraticDrag else "command"
    told = getattr(kind, hook)
    monkeypatch.setattr(kind, hook, lambda *args, told=told: asked.append(told) or told(*args))
  by_itself = reduced.simulate(theta, segments)
  assert not asked
  monkeypatch.setattr(Simulation, "_by_motion", lambda *_: None)
  np.testing.assert_allclose(by_itself, reduced.simulate(theta, segments), rtol=0.0, atol=1e-7)
  assert asked
  assert np.abs(by_itself[1:] - by_itself[:1]).max(axis=(1, 2, 3)).min() > 0.01


def test_a_run_leaves_a_motor_as_warm_as_its_periods_do(reduced, mujoco_car):
  theta = reduced.parameters.vector({"motor_heating": 0.2, "motor_heating_time": 5.0})[None]
  commands, rest = np.tile([2.0, 0.0], (200, 1, 1)), np.full((1, 201, 4), np.nan)
  warmth = []
  for twin in (reduced, mujoco_car):
    cars = twin.begin(theta, np.zeros((1, len(START))))
    cars.run(commands, rest, np.array([200]))
    warmth += [slot.state["warmth"] for slot in cars._slots if slot.mechanism.name == "motor_heating"]
  np.testing.assert_allclose(warmth, 4.0 * -np.expm1(-2.0 / 5.0), rtol=1e-9)
