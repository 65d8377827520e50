"""Ages are told from the youngest sensor."""

import pytest

from calibration.characterise.study import Term, no_age_below_zero

WANTED = 3.0


def term(name, value, std=0.001):
  return Term(name, value, std, "s", abs(value) > WANTED * std)


def told(*terms):
  return {t.name: t for t in no_age_below_zero(terms, "pose_latency", WANTED)}


def test_a_sensor_that_speaks_before_the_clock_makes_the_clock_late():
  found = told(
    term("encoder_latency", -0.020), term("imu_latency", 0.010), term("steering_delay", 0.021), term("gyro_scale", 0.03)
  )
  assert found["pose_latency"].value == pytest.approx(0.020) and found["pose_latency"].there
  assert found["encoder_latency"].value == 0.0 and not found["encoder_latency"].there
  assert found["imu_latency"].value == pytest.approx(0.030) and found["imu_latency"].there
  assert found["steering_delay"].value == pytest.approx(0.001) and not found["steering_delay"].there
  assert found["gyro_scale"] == term("gyro_scale", 0.03)


def test_what_chance_makes_of_an_age_moves_no_clock():
  terms = (term("encoder_latency", -0.002), term("imu_latency", 0.010), term("drive_delay", 0.02))
  assert tuple(told(*terms).values()) == terms
  assert told(term("gyro_scale", 0.03)) == {"gyro_scale": term("gyro_scale", 0.03)}
