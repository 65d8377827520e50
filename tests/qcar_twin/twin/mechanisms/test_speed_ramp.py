"""The speed controller's ramp against its own straight lines, and where a stretch begins."""

import numpy as np
import pytest

from qcar_twin.plant import LEAD
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.mechanisms.base import Context
from qcar_twin.twin.twin import Twin
from tests.qcar_twin.twin.mechanisms.test_speed_loop import CAR, MOTOR, PERIOD, TRAVEL, drive, shown

RATE = 2.0  # m/s^2


@pytest.fixture(params=["reduced", "mujoco"])
def twin(request) -> Twin:
  return Twin(CAR, select(["speed_ramp"]), substeps=2, threads=1, engine=request.param)


def acted(commands: np.ndarray, inverse: float = 1.0 / RATE, fine: int = 1) -> np.ndarray:
  """What acts of commands (T,), each held for a period that is cut into `fine` parts, as means over whole periods."""
  (mechanism,) = select(["speed_ramp"])
  theta, period = np.array([[inverse]]), PERIOD / fine
  state, out = {"setpoint": np.zeros(1)}, []
  for command in np.repeat(commands, fine):
    context = Context(None, period, 0.0, np.zeros((1, 10)), np.array([[command, 0.0]]), *[np.zeros((1, 2))] * 6)
    out.append(mechanism.command(theta, context, state, np.array([[command, 0.3]]))[0])
  assert (np.array(out)[:, 1] == 0.3).all()
  return np.array(out)[:, 0].reshape(len(commands), fine).mean(axis=1)


def test_the_setpoint_goes_in_a_straight_line_and_stays(twin):
  driven = shown(twin, twin.parameters.vector({"speed_ramp": 1.0 / RATE}), drive(np.full(150, 1.0)))[:, MOTOR] * TRAVEL
  free = shown(twin, twin.parameters.vector({"speed_ramp": 0.0}), drive(np.full(150, 1.0)))[:, MOTOR] * TRAVEL
  rising = np.diff(driven[20:45]) / PERIOD
  assert rising.mean() == pytest.approx(RATE * free[-1], rel=0.05)  # of the speed that the loop reaches at 1 m/s
  assert driven[-1] == pytest.approx(free[-1], rel=1e-3)
  assert free[:20].max() > 2.0 * driven[:20].max()


def test_means_over_periods_are_exact():
  """Also where the command is reached within a period, and where it turns back on the way."""
  commands = np.concatenate([np.full(13, 0.233), np.full(7, -0.1), np.full(3, 0.011), np.full(20, 0.5)])
  np.testing.assert_allclose(acted(commands), acted(commands, fine=50), atol=1e-12)
  assert np.abs(np.diff(acted(commands))).max() <= RATE * PERIOD * (1.0 + 1e-9)


def test_without_a_ramp_the_command_acts_as_it_is():
  commands = np.array([0.0, 1.0, -2.0, 0.3])
  np.testing.assert_allclose(acted(commands, inverse=0.0), commands, atol=1e-9)


def test_a_stretch_under_way_begins_at_the_command_that_its_motion_took(twin):
  """In a launch's middle the set-point is not at the command yet; in steady driving it is."""
  theta = twin.parameters.vector({"speed_ramp": 1.0 / RATE})
  speed = 0.5 / TRAVEL
  lead = np.zeros((1, len(LEAD)))
  lead[0] = [2.0, speed, RATE / TRAVEL, 0.1]
  begun = shown(twin, theta, drive(np.full(60, 2.0), start=0.5, lead=lead))[:, MOTOR] * TRAVEL
  jumped = shown(twin, theta, drive(np.full(60, 2.0), start=0.5))[:, MOTOR] * TRAVEL
  assert begun[10] - begun[0] == pytest.approx(RATE * 0.1, rel=0.5)
  assert jumped[10] - jumped[0] > 2.0 * (begun[10] - begun[0])
