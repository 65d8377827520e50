"""FF-FB and the linear rate policy: signs, limits, steady behaviour, what a mismatch does to each."""

import numpy as np
import pytest

from agents.control.feedforward import FeedforwardFeedback
from agents.control.kpis import kpis
from agents.control.linear_rate import LinearRate
from agents.control.lq import steady_curve
from agents.control.team import Team
from qcar_twin.paths import path_from_pieces, turn
from tests.agents.control.test_lq import situation
from tests.agents.control.tracking_rig import CAR, Actuation, follow

RATE = LinearRate(np.array([235.0, 37.0, 3.0, 2.0]))


def test_feedforward_alone_is_the_steady_steering_of_the_curve():
  controller = FeedforwardFeedback(CAR, gain=0.0, preview=0.5)
  assert controller.steer(situation([0.1, 0, 0.2, 0], curvature=0.8))[0] == pytest.approx(
    0.8 * steady_curve(CAR, 0.5)[0]
  )


def test_steady_sideslip_does_not_pull_the_car_off_the_curve():
  """On the path with heading error -beta_ss the feedback is silent."""
  delta, heading = steady_curve(CAR, 0.5)
  controller = FeedforwardFeedback(CAR, gain=3.0, preview=0.5)
  steering = controller.steer(situation([0.0, 0.0, 0.8 * heading, 0.0], curvature=0.8))
  assert steering[0] == pytest.approx(0.8 * delta, rel=1e-9)


def test_feedback_steers_against_the_error_seen_ahead():
  controller = FeedforwardFeedback(CAR, gain=2.0, preview=0.5)
  assert controller.steer(situation([0.1, 0, 0, 0]))[0] == pytest.approx(-0.2)
  assert controller.steer(situation([0.0, 0, 0.1, 0]))[0] == pytest.approx(-0.1)


def test_ff_fb_settles_in_a_curve_without_error():
  bend = path_from_pieces("bend", [(0.3, 0.0, 0.0), *turn(4.0, 1.0, 0.5)[:2]])
  result = follow(FeedforwardFeedback(CAR, 3.0, 0.5), bend)
  assert abs(result.cross_track[-40, 0]) < 1e-3


def test_rate_policy_integrates_a_bounded_rate():
  policy = LinearRate(np.array([10.0, 0.0, 0.0, 0.0]), largest=1.5, lock=0.5)
  now = situation([[0.05, 0, 0, 0], [-9.0, 0, 0, 0], [9.0, 0, 0, 0]])
  now.steering[:] = (0.1, 0.1, -0.499)
  assert policy.steer(now).tolist() == pytest.approx([0.1 - 0.005, 0.1 + 0.015, -0.5])


def test_rate_policy_leaves_no_steady_error_under_a_mismatch_and_ff_fb_does():
  """Steering gain 0.92 and 1 degree of offset: integral action absorbs both."""
  line = path_from_pieces("line", [(5.0, 0.0, 0.0)])
  wrong = Actuation(gain=0.92, offset=np.radians(1.0))
  both = Team((RATE, FeedforwardFeedback(CAR, 2.0, 0.5)), 1)
  rate, spring = follow(both, line, count=2, actuation=wrong).cross_track[-50]
  assert abs(rate) < 5e-4 < 5e-3 < abs(spring)
  assert spring == pytest.approx(np.radians(1.0) / 0.92 / 2.0, rel=0.1)


@pytest.mark.parametrize("path", ["s", "infinity"])
def test_every_law_follows_every_path_on_the_true_state(path):
  laws = Team((FeedforwardFeedback(CAR, 3.0, 0.5), RATE), 1)
  result = kpis(follow(laws, path, count=2, speed=1.0, actuation=Actuation(delay=0.0, lag=0.0)))
  assert result.finished.all() and result.inside.all()
  assert result.rmse.max() < 0.006 and result.me.max() < 0.02
