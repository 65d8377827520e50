"""The loop itself: speed control, servo, progress, ends, indicators."""

import dataclasses
import math

import numpy as np
import pytest

from agents.control.closed_loop import Actuation, Scenario, start_states
from agents.control.controllers import make
from agents.control.kpis import kpis
from agents.control.speed import SpeedController, SpeedGains
from agents.learning.environments import make_env
from qcar_twin.estimation.observer import SensedObserver
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.paths import path_from_pieces, path_named
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors
from qcar_twin.tracks import path_from
from tests.agents.control.tracking_rig import CAR, PLANT, THETA, follow

LINE = path_from_pieces("line", [(3.0, 0.0, 0.0)])
SHORT = "random:1:2"  # 3 m, a turn between straights
LQ = make("lq_cm", {"cross_track_rate": 0.15, "heading": 0.1, "heading_rate": 1e-3, "effort": 0.03}, CAR, 0.5)


@dataclasses.dataclass(frozen=True)
class Straight:
  """Never steers."""

  name: str = "straight"
  angle: float = 0.0

  def steer(self, situation):
    return np.full(len(situation.arc_length), self.angle)


def test_sensors_of_another_period_than_the_plants_are_refused():
  suite = SensorSuite(qcar_sensors(), 1, 0, period=0.005)
  with pytest.raises(ValueError, match="sensors of a period of 0.005 s on a plant of 0.01 s"):
    follow(LQ, LINE, observer=SensedObserver(suite, CAR, FilterSettings(period=0.005)))


@dataclasses.dataclass
class Failing:
  """LQ, but for one answer of the second car."""

  calls: int = 0
  name: str = "failing"

  def steer(self, situation):
    answer, self.calls = LQ.steer(situation), self.calls + 1
    return np.where((self.calls == 100) & (np.arange(len(answer)) == 1), np.nan, answer)


def test_a_controller_whose_answer_is_no_number_has_lost_its_car():
  driven = follow(Failing(), LINE, count=2)
  assert driven.finished.tolist() == [True, False]
  assert driven.under_way[:, 1].sum() == 99 and np.isfinite(driven.signals).all()
  assert np.isinf(kpis(driven).rmse[1]) and np.isfinite(kpis(driven).rmse[0])


def test_a_speed_that_the_car_does_not_reach_is_refused_before_the_drive():
  fastest = 1.02 * (11.1 - SpeedGains.design(CAR).friction) / SpeedGains.design(CAR).hold
  with pytest.raises(ValueError, match=r"speed .* m/s: it takes 11\.3 V of 11\.1 V; ask for less"):
    follow(LQ, LINE, speed=fastest)
  with pytest.raises(ValueError, match="speed 50 m/s"):
    make_env(path="s", speed=50.0)
  with pytest.raises(ValueError, match=r"it takes a duty of 50 of 1; ask for less"):
    SpeedGains(1.0, 0.0, 1.0, 1.0, limit=1.0, unit="-").require(50.0)


# -- speed ---------------------------------------------------------------------------------------


def run_speed(target, seconds, start=0.0, gain_error=1.0, limit=11.1):
  """Speed over time on a drive whose P1 is `gain_error` times what the controller believes."""
  gains = SpeedGains.design(CAR, response_time=0.3, limit=limit)
  controller, speed, out = SpeedController(gains, np.array([start])), start, []
  theta = THETA.copy()
  theta[PLANT.parameters.index("drive_gain")] *= gain_error
  state = np.zeros((1, 7))
  state[0, 3] = start
  simulation = PLANT.begin(theta[None], state)
  for _ in range(round(seconds / 0.01)):
    voltage = controller.voltage(np.array([speed]), target, 0.01)
    speed = float(simulation.step(np.array([[voltage[0], 0.0]]))[0, 3])
    out.append((speed, voltage[0]))
  return np.array(out)


def test_speed_follows_like_a_lag_of_the_response_time():
  speed = run_speed(0.6, 3.0, start=0.3)[:, 0]
  time = 0.01 * np.arange(1, len(speed) + 1)
  np.testing.assert_allclose(speed, 0.6 - 0.3 * np.exp(-time / 0.3), atol=0.005)


@pytest.mark.parametrize("gain_error", [0.8, 1.25])
def test_integral_action_removes_a_wrong_motor_constant(gain_error):
  assert run_speed(0.5, 6.0, gain_error=gain_error)[-1, 0] == pytest.approx(0.5, abs=2e-3)


def test_reverse_is_driven_as_well():
  assert run_speed(-0.4, 6.0)[-1, 0] == pytest.approx(-0.4, abs=2e-3)


def test_integrator_does_not_wind_up_at_the_limit():
  gains = SpeedGains.design(CAR, limit=1.0)
  controller = SpeedController(gains, np.zeros(1))
  for _ in range(1000):
    assert controller.voltage(np.zeros(1), 5.0, 0.01)[0] == 1.0
  assert controller.voltage(np.array([5.0]), 0.0, 0.01)[0] < 0.0


def test_a_speed_that_was_not_measured_leaves_the_integrator_as_it_is():
  gains = SpeedGains.design(CAR)
  controller, steady = SpeedController(gains, np.array([0.5])), gains.hold * 0.5 + gains.friction
  for _ in range(3):
    assert controller.voltage(np.array([np.nan]), 0.5, 0.01) == pytest.approx([steady])
  assert controller.voltage(np.array([0.5]), 0.5, 0.01) == pytest.approx([steady])


def test_takes_over_a_moving_car_without_a_bump():
  gains = SpeedGains.design(CAR)
  controller = SpeedController(gains, np.array([0.5, 0.5]))
  steady = gains.hold * 0.5 + gains.friction
  assert controller.voltage(np.array([0.5, 0.5]), 0.5, 0.01) == pytest.approx([steady, steady])
  controller.voltage(np.array([0.0, 0.0]), 0.5, 0.01)
  controller.restart(np.array([True, False]), np.array([0.5, 0.5]))
  first, second = controller.voltage(np.array([0.5, 0.5]), 0.5, 0.01)
  assert first == pytest.approx(steady) and second > steady


# -- task --------- ------------------------------------------------------------------------------


def test_cars_start_beside_the_path_as_told():
  task = Scenario(path_named("infinity"), offset=np.array([0.05, -0.05]), heading=0.1)
  start = start_states(task, 2)
  arc = task.path.nearest(start[:, 0], start[:, 1], near=np.zeros(2))
  across = task.path.errors(arc, start[:, :3], start[:, 3:5], start[:, 5]).cross_track
  assert across == pytest.approx([0.05, -0.05], abs=1e-9) and arc == pytest.approx([0.0, 0.0], abs=1e-6)
  assert start[:, 2] == pytest.approx(np.full(2, task.path.yaw[0] + 0.1)) and np.all(start[:, 3] == 0.5)


# -- indicators ----------------------------------------------------------------------------------


def test_a_straight_car_on_a_straight_path_has_no_error():
  result = follow(Straight(), LINE)
  indicators = kpis(result)
  assert indicators.finished.all() and indicators.me[0] < 1e-12 and indicators.iaca[0] == 0.0
  assert result.time[-1] == pytest.approx(6.0, abs=0.1)


def test_a_constant_offset_is_both_me_and_rmse():
  indicators = kpis(follow(Straight(), LINE, offset=0.03))
  assert (indicators.me[0], indicators.rmse[0]) == pytest.approx((0.03, 0.03), abs=1e-6)


def test_indicators_are_the_papers_integrals():
  result = follow(LQ, path_from(SHORT))
  indicators = kpis(result)
  until = result.under_way[:, 0]
  error, steering = result.cross_track[until, 0], result.commands[until, 0, 1]
  duration = until.sum() * 0.01
  assert indicators.rmse[0] == pytest.approx(math.sqrt(np.sum(error**2) * 0.01 / duration))
  assert indicators.me[0] == pytest.approx(np.abs(error).max())
  assert indicators.iaca[0] == pytest.approx(np.sum(np.abs(steering)) * 0.01 / duration)


def test_a_car_that_leaves_the_path_has_not_finished():
  indicators = kpis(follow(Straight(), path_from(SHORT)))
  assert not indicators.finished[0] and not indicators.inside[0] and np.isinf(indicators.rmse[0])


def test_steering_beyond_the_lock_is_cut():
  result = follow(Straight(angle=2.0), LINE, lock=0.3)
  assert np.abs(result.commands[..., 1]).max() == 0.3


def test_touching_a_border_is_noticed():
  wide = follow(LQ, "c", count=2, offset=np.array([0.0, 0.0]), speed=1.0)
  assert kpis(wide).inside.all()
  moved = dataclasses.replace(wide, signals=wide.signals + np.array([0, 0.03] + [0] * 8))
  assert not kpis(moved).inside.any()


def test_laps_are_counted_on_closed_paths():
  circle = path_from_pieces("circle", [(2.0 * math.pi * 0.7, 1.0 / 0.7, 1.0 / 0.7)], closed=True)
  result = follow(LQ, circle, laps=2, speed=1.0)
  assert kpis(result).finished[0]
  assert result.arc_length[-1, 0] == pytest.approx(2 * circle.length, abs=0.1)


def test_error_is_the_distance_to_the_path():
  result = follow(LQ, path_from(SHORT), offset=0.04)
  path = result.path
  for k in range(0, len(result.time), 100):
    x, y = result.signals[k, 0, :2]
    nearest = np.hypot(path.x - x, path.y - y).min()
    error = abs(result.cross_track[k, 0])
    assert error - 1e-6 <= nearest <= np.hypot(error, 0.003)  # the stored points are 5 mm apart


def test_with_sensors_and_filter_the_loop_stays_at_the_noise_floor():
  """Position noise 8 mm coloured, 50 ms latency, spikes, servo of 40 ms: RMSE below 8 mm through a turn."""
  count = 4
  observer = SensedObserver(
    SensorSuite(qcar_sensors(), count, 0), CAR, FilterSettings(steering_lag=0.05, lidar_correlation=0.3)
  )
  result = follow(LQ, path_from(SHORT), count=count, observer=observer, actuation=Actuation())
  indicators = kpis(result)
  assert indicators.finished.all() and np.median(indicators.rmse) < 0.008 and indicators.me.max() < 0.03
  assert result.valid.all()
