"""A measured response is shown with an answer only where it is the same step from the same start."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.identification.match_bicycle import Answer, Level
from calibration.identification.steering_steps import Turn
from calibration.identification.step_detection import Step
from calibration.twin_calibration.measured_steps import MeasuredSteps
from calibration.twin_calibration.report import step_chart
from qcar_twin.pages.charts import unpacked

TIME = 0.01 * np.arange(-50, 100)
RISING = np.clip(TIME, 0.0, None)


def answer(channel, level, time=TIME):
  filtered, drawn = np.full(len(time), 9.0), np.stack([np.clip(time, 0.0, None), np.clip(2.0 * time, 0.0, None)])
  return Answer(channel, Level(level, "identify"), time, filtered, filtered, 1.0, drawn)


def step(level, values, role="identify"):
  return Step("run", role, level, TIME, np.zeros((len(TIME), 2)), {"motor_speed": values, "yaw_rate": values}, None)


def turn(level, speed):
  return Turn(step(level, RISING), np.full(len(TIME), speed), {"yaw_rate": RISING})


def test_a_step_from_rest_is_the_same_and_one_under_way_is_not():
  time, value = MeasuredSteps((step(2.0, RISING),), ()).response(answer("motor_speed", 2.0))
  assert time[0] == pytest.approx(0.0) and value[0] == 0.0 and len(time) == 100
  others = (step(2.0, RISING + 5.0), step(1.5, RISING), step(2.0, RISING, "validate"))
  assert MeasuredSteps(others, ()).response(answer("motor_speed", 2.0)) is None


def test_of_step_steers_the_one_at_the_answers_speed_is_shown():
  assert MeasuredSteps((), (turn(0.1, 0.8),)).response(answer("yaw_rate", 0.1)) is None
  assert MeasuredSteps((), (turn(0.1, 0.8), turn(0.1, 1.45))).response(answer("yaw_rate", 0.1)) is not None
  assert MeasuredSteps((), (turn(0.2, 1.5),)).response(answer("yaw_rate", 0.1)) is None


def test_the_chart_begins_at_the_step_and_draws_what_no_filter_smeared():
  measured = MeasuredSteps((), (turn(0.1, 1.5),))
  traces = step_chart([answer("yaw_rate", 0.1)], measured, "", "V").data()["traces"]
  assert [t["name"] for t in traces] == ["measured", "bicycle", "twin"]
  for trace, slope in zip(traces, (1.0, 2.0, 1.0), strict=True):
    time, value = unpacked(trace["x"]), unpacked(trace["y"])
    assert time[0] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(value, slope * time, atol=1e-5)
  alone = step_chart([answer("yaw_rate", 0.1)], SimpleNamespace(response=lambda _: None), "", "V").data()["traces"]
  assert [t["name"] for t in alone] == ["bicycle", "twin"]


@pytest.mark.parametrize(("unit", "said"), [("V", "2 V, identify"), ("m/s", "2 m/s, identify"), ("-", "2, identify")])
def test_a_step_of_the_drive_is_told_in_the_unit_of_its_command(unit, said):
  chart = step_chart([answer("motor_speed", 2.0)], MeasuredSteps((), ()), "", unit)
  assert f"{said}: " in str(chart.data())
