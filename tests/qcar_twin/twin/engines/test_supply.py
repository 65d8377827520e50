"""The supply's resistance acts in the motor's circuit, alike in both engines."""

import numpy as np
import pytest

from qcar_twin.plant import START, Segments
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

LOSS, LOW, HIGH = 0.1, 2.0, 3.5  # at 2.5 V, V, V


def motor_speed(engine: str) -> np.ndarray:
  """Of a car without and one with the loss, (2, T + 1), through two voltages and a reversal."""
  twin = Twin(QCAR, [catalogue()["battery_sag"]], engine=engine)
  commands = np.zeros((1, 200, 2))
  commands[0, :, 0] = np.repeat([LOW, HIGH, -1.0, 1.5], [60, 60, 40, 40])
  theta = np.tile(twin.parameters.nominal, (2, 1))
  theta[1, twin.parameters.index("battery_sag")] = LOSS
  start = np.zeros((1, len(START)))
  segments = Segments(commands, start, np.array([200]), twin.period, ("drive",), np.zeros(1))
  return twin.rollout(theta, segments).signals[:, 0, :, 8]


def test_both_engines_lose_the_same_to_the_supply():
  exact, reduced = motor_speed("mujoco"), motor_speed("reduced")
  lost, lost_reduced = exact[0] - exact[1], reduced[0] - reduced[1]
  assert lost_reduced == pytest.approx(lost, abs=0.02 * np.abs(lost).max())


def test_the_loss_at_the_beginning_is_the_circuits():
  """A standing motor's torque is divided by 1 + s (u / 2.5 V)^2, and so is its first acceleration, friction aside."""
  exact = motor_speed("mujoco")
  assert exact[1, 8] / exact[0, 8] == pytest.approx(1.0 / (1.0 + LOSS * (LOW / 2.5) ** 2), rel=0.02)
