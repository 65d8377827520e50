"""Starts in mid-drive: what wheels and gyro say of a car that slips is turned into the state it is in."""

import numpy as np
import pytest

from qcar_twin.plant import START, signal_index
from qcar_twin.twin.starts import slipping
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

TWIN = Twin(QCAR, [], threads=1, engine="reduced")
PERIOD, SPAN = TWIN.period, 5  # s; control periods on either side, over which rates are taken


def driven(volts: float, steering: float, seconds: float, start: np.ndarray) -> dict[str, np.ndarray]:
  """Signals of a car after each control period, and those a sensor would show of its start."""
  cars = TWIN.begin(TWIN.parameters.nominal[None], start[None])
  rows = np.concatenate([cars.step(np.array([[volts, steering]])).copy() for _ in range(round(seconds / PERIOD))])
  return {name: rows[:, signal_index(name)] for name in ("velocity_x", "velocity_y", "yaw_rate", "motor_speed")}


def begun(signals: dict[str, np.ndarray], at: int) -> np.ndarray:
  """The twin's start state, (7,), from motor speed and yaw rate about a control period."""
  rolling = signals["motor_speed"] * QCAR.gear_ratio * QCAR.wheel_radius
  state, rate = np.zeros((1, len(START))), np.zeros((1, len(START)))
  state[0, 3:6] = rolling[at], signals["yaw_rate"][at] * QCAR.cg_to_rear, signals["yaw_rate"][at]
  rate[0, 3] = (rolling[at + SPAN] - rolling[at - SPAN]) / (2 * SPAN * PERIOD)
  values = {name: np.array([p.nominal]) for name, p in zip(TWIN.base.names, TWIN.base, strict=True)}
  return slipping(state, rate, values, QCAR.wheelbase, 1.0)[0]


@pytest.mark.parametrize("at", [15, 30])
@pytest.mark.parametrize("volts", [2.5, -2.5])
def test_a_start_in_a_launch_is_slower_than_its_wheels_by_their_slip(volts, at):
  signals = driven(volts, 0.0, 0.5, np.zeros(7))
  rolling = signals["motor_speed"][at] * QCAR.gear_ratio * QCAR.wheel_radius
  error = begun(signals, at)[3] - signals["velocity_x"][at]
  assert abs(error) < 0.35 * abs(rolling - signals["velocity_x"][at])


def test_a_start_in_a_turn_slides_as_its_rear_tyres_do():
  start = np.zeros(7)
  start[3] = 1.2
  signals = driven(1.2, 0.2, 3.0, start)
  rolling, truth = signals["yaw_rate"][-20] * QCAR.cg_to_rear, signals["velocity_y"][-20]
  assert abs(begun(signals, len(signals["yaw_rate"]) - 20)[4] - truth) < 0.35 * abs(rolling - truth)


def test_a_car_that_stands_starts_at_rest():
  values = {name: np.array([p.nominal]) for name, p in zip(TWIN.base.names, TWIN.base, strict=True)}
  assert not slipping(np.zeros((1, 7)), np.ones((1, 7)), values, QCAR.wheelbase, 1.0).any()


def test_slip_is_bounded():
  values = {name: np.array([p.nominal]) for name, p in zip(TWIN.base.names, TWIN.base, strict=True)}
  start, rate = np.zeros((1, 7)), np.zeros((1, 7))
  start[0, 3], rate[0, 3] = 1.0, 1e6
  assert slipping(start, rate, values, QCAR.wheelbase, 0.5)[0, 3] == pytest.approx(0.8)
