"""Commands that act late in place of sensors that all speak late."""

import numpy as np
import pytest

from calibration.fitting.tolerances import exchanged
from qcar_twin.parameters import Parameter, ParameterSet

STD = 0.005  # s


def delay(name: str, lower: float = -0.1, std: float = STD) -> Parameter:
  return Parameter(name, 0.0, lower, 0.1, "s", "d", std=std, null=0.0, typical=0.03)


COMMANDS = (delay("drive_delay", 0.0), delay("steering_delay", 0.0))
SENSORS = (delay("encoder_latency"), delay("imu_latency"), delay("pose_latency"))
OTHER = Parameter("mass", 2.7, 1.0, 4.0, "kg", "m", std=0.1)
ALL = ParameterSet((OTHER, *SENSORS, *COMMANDS))


def test_what_all_sensors_have_in_common_goes_to_the_commands():
  """Five equal deviations of 25 ms in all: two fifths of a shift of two and three are 15 and 10 ms."""
  start = exchanged(ALL, np.array([2.8, 0.025, 0.025, 0.025, 0.0, 0.0]), 10.0)
  np.testing.assert_allclose(start, [2.8, 0.010, 0.010, 0.010, 0.015, 0.015], atol=1e-9)


def test_and_the_other_way_round_no_further_than_bounds_let_it():
  start = exchanged(ALL, np.array([2.7, -0.03, -0.03, -0.03, 0.05, 0.02]), 10.0)
  np.testing.assert_allclose(start, [2.7, -0.01, -0.01, -0.01, 0.03, 0.0], atol=1e-9)


def test_a_sum_is_kept_by_each_pair_of_command_and_sensor():
  theta = np.array([2.7, 0.02, 0.026, 0.031, 0.004, 0.001])
  start = exchanged(ALL, theta, 10.0)
  assert start is not None
  for sensor in (1, 2, 3):
    np.testing.assert_allclose((start[4:] + start[sensor]), theta[4:] + theta[sensor])


@pytest.mark.parametrize(
  ("parameters", "theta"),
  [
    (ALL, [2.7, 0.004, 0.003, 0.005, 0.001, 0.002]),  # hardly likelier
    (ALL, [2.7, 0.03, -0.03, 0.0, 0.0, 0.0]),  # nothing in common
    (ParameterSet((*SENSORS, COMMANDS[0])), [0.03, 0.03, 0.03, 0.0]),  # steering is not late with it
    (ParameterSet(COMMANDS), [0.05, 0.05]),
  ],
)
def test_else_there_is_nothing_to_exchange(parameters, theta):
  assert exchanged(parameters, np.array(theta), 10.0) is None
