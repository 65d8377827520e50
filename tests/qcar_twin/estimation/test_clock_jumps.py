"""A clock that is set back or forward while the car drives: the estimate goes on, or says that it must not be used."""

import pytest

from agents.control.model import Model
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.settings import FilterSettings

PERIOD, JUMP_AT, SECONDS = 0.01, 5.0, 15.0


def driven(jump: float, silence: float = 0.0, slipping: float = 0.0):
  """(true time, estimate) of each period of a straight drive at 1 m/s; stamps jump back by `jump`, or nothing arrives
  for `silence`, from JUMP_AT on, s, and the wheels come to turn faster by the share `slipping`."""
  online = FederatedFilter(Model.nominal().car, FilterSettings())
  out = []
  for k in range(round(SECONDS / PERIOD)):
    true = k * PERIOD
    now = 1000.0 + true - (jump if true >= JUMP_AT else 0.0)
    if not JUMP_AT <= true < JUMP_AT + silence:
      turning = 318.0 * (1.0 + slipping * min(max(true - JUMP_AT, 0.0) / 5.0, 1.0))
      samples = {"motor_voltage": 1.1, "motor_speed": turning + 0.5 * (-1) ** k, "yaw_rate": 0.0}
      if k % 10 == 0:
        samples |= {"pose_x": true, "pose_y": 0.0, "pose_yaw": 0.0, "pose_score": 100.0}
      for channel, value in samples.items():
        online.update(now, channel, value)
    out.append((true, online.estimate(now)))
  return [(true, estimate) for true, estimate in out if true >= JUMP_AT]


@pytest.mark.parametrize(
  ("jump", "silence"),
  [(0.0, 0.0), (0.1, 0.0), (0.5, 0.0), (0.53, 0.0), (5.0, 0.0), (1000.0, 0.0), (0.0, 2.0), (0.0, 7.0)]
  + [(-0.05, 0.0), (-0.53, 0.0), (-2.35, 0.0), (-60.0, 0.0), (-1.7e9, 0.0)],  # forward, the last one from 1970 on
)
def test_what_is_valid_lies_within_its_bound(jump, silence):
  after = driven(jump, silence)
  valid = [(true, e) for true, e in after if e.valid]
  beyond = [true for true, e in valid if abs(e.pose_x - true) > e.bounds[0]]
  assert len(beyond) <= 0.05 * len(valid)
  assert len(valid) > 0.9 * len(after) or silence > 2.0
  true, last = after[-1]
  assert last.valid and abs(last.pose_x - true) < 0.05


def test_a_clock_that_was_set_back_is_said_and_a_sound_one_is_not():
  assert any("set back by 1e+03 s" in text for text in driven(1000.0)[-1][1].warnings)
  assert any("set back by 0.5 s" in text for text in driven(0.5)[-1][1].warnings)
  assert not any("clock" in text for text in driven(0.0)[-1][1].warnings)


def test_a_clock_that_was_set_forward_is_no_latency_of_the_poses():
  for forward in (0.05, 0.15, 0.53, 7.05):
    assert not any("poses are taken to be" in text for text in driven(-forward)[-1][1].warnings)


def test_a_latency_that_begins_while_other_sensors_are_heard_is_still_found():
  online = FederatedFilter(Model.nominal().car, FilterSettings())
  for k in range(600):
    now, late = PERIOD * k, 5 * (k >= 300)  # periods
    for channel, value in {"motor_voltage": 1.1, "motor_speed": 318.0 + 0.5 * (-1) ** k, "yaw_rate": 0.0}.items():
      online.update(now, channel, value)
    if k % 10 == late:
      place = now - PERIOD * late
      for channel, value in {"pose_x": place, "pose_y": 0.0, "pose_yaw": 0.0, "pose_score": 100.0}.items():
        online.update(now, channel, value)
    estimate = online.estimate(now)
  assert "the poses are taken to be 50 ms older than their stamps say" in estimate.warnings


@pytest.mark.parametrize("jump", [0.0, 1000.0])
def test_wheels_that_slip_are_noticed_by_the_fixes_whatever_the_clock_did(jump):
  warnings = [text for _, estimate in driven(jump, slipping=0.5) for text in estimate.warnings]
  assert "the encoder contradicts the poses and is left out" in warnings


def test_an_estimate_that_is_asked_for_at_a_late_fix_is_no_clock_that_was_set_back():
  online = FederatedFilter(Model.nominal().car, FilterSettings())
  for k in range(300):
    now = 0.01 * k
    for channel, value in {"motor_voltage": 1.1, "motor_speed": 318.0, "yaw_rate": 0.0}.items():
      online.update(now, channel, value)
    estimate = online.estimate(now)
    if k % 10 == 0 and k >= 10:
      for channel, value in {"pose_x": now - 0.1, "pose_y": 0.0, "pose_yaw": 0.0, "pose_score": 100.0}.items():
        online.update(now - 0.1, channel, value)
      estimate = online.estimate(now - 0.1)
  assert not any("clock" in text for text in estimate.warnings)
