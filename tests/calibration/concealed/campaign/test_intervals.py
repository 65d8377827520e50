"""Exact intervals of shares, and what is counted of a campaign."""

import math

import pytest

from calibration.concealed.campaign.intervals import counts, exact_interval, exact_rate, interval_table
from tests.calibration.concealed.campaign.test_campaign import DELAY, result


def test_the_interval_is_clopper_and_pearsons():
  low, high = exact_interval(0, 20)
  assert low == 0.0
  assert (1 - high) ** 20 == pytest.approx(0.025)  # none of 20 is as rare as 2.5 % at the upper end
  assert exact_interval(20, 20)[0] == pytest.approx(1 - high)
  with pytest.raises(ValueError, match="share of nothing"):
    exact_interval(0, 0)


def test_the_interval_of_a_rate_is_garwoods():
  low, high = exact_rate(0, 2.0)
  assert low == 0.0 and math.exp(-2.0 * high) == pytest.approx(0.025)  # none is as rare as 2.5 % at the upper end
  low, high = exact_rate(1, 2.0)
  assert 1.0 - math.exp(-2.0 * low) == pytest.approx(0.025)  # one or more at the lower end
  assert (1.0 + 2.0 * high) * math.exp(-2.0 * high) == pytest.approx(0.025)
  with pytest.raises(ValueError, match="rate over nothing"):
    exact_rate(0, 0.0)


def test_shares_are_counted_and_shown():
  results = [
    result("null", []),
    result("null", [], ["gyro_scale"]),
    result("single", DELAY, ["steering_delay"]),
    result("single", DELAY, ["gyro_scale", "steering_delay"]),
    result("single", DELAY, [], nats=3.0),
  ]
  shares = {said: (many, of) for said, many, of in counts(results)}
  assert shares["sessions without an effect: something claimed"] == (1, 2)
  assert shares["the same, with a probability above 0.8"] == (1, 2)
  assert shares["single effects: right name first"] == (1, 3)
  assert shares["of those that the right model sees (20 nats or more)"] == (1, 2)
  assert shares["single effects: right name among the claims"] == (2, 3)
  assert shares["single effects: a wrong name first"] == (1, 3)
  table = interval_table(results)
  assert "| 1 of 2 | 0.50 | 0.01 to 0.99 |" in table
  assert "without" not in interval_table(results[2:])
