"""What the filter says to input that cannot be: which it is, and a cure."""

import math

import numpy as np
import pytest

from agents.control.model import Model
from qcar_twin.estimation.batch import FederatedBatch
from qcar_twin.estimation.estimate import BROKEN
from qcar_twin.estimation.federated import FederatedFilter
from qcar_twin.estimation.observer import SensedObserver
from qcar_twin.estimation.offline import filter_recording
from qcar_twin.estimation.settings import ESTIMATED, FilterSettings
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Stream
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors
from scripts import benchmark_filter
from tests import ROOT
from tests.qcar_twin.estimation.estimation_rig import CAR, journey, run


@pytest.mark.parametrize(
  ("wrong", "says"),
  [
    ({"speed_std": math.nan}, r"speed_std is not a number; leave it out for 0.03"),
    ({"walk_yaw": -0.01}, "walk_yaw is -0.01; it must not be negative"),
    ({"steering_gain_std": -1.0}, "steering_gain_std is -1; it must not be negative"),
    ({"steering_delay": -0.02}, "steering_delay is -0.02; it must not be negative"),
    ({"period": 0.0}, "period is 0; it must be positive"),
    ({"speed_scale": 0.0}, "speed_scale is 0; it must be positive"),
    ({"gate": 1.5}, "gate is 1.5; a probability lies between 0 and 1"),
    ({"sharing": (0.0, 1.0)}, "must lie in"),
  ],
)
def test_settings_that_cannot_be_are_refused_by_name(wrong, says):
  with pytest.raises(ValueError, match=says):
    FilterSettings(**wrong)


def test_names_that_do_not_exist_come_with_the_nearest():
  with pytest.raises(ValueError, match="no filter engine 'filter_py'; did you mean 'filterpy'"):
    FederatedFilter(CAR, engine="filter_py")
  with pytest.raises(KeyError, match="did you mean 'yaw_rate'"):
    FederatedFilter(CAR).update(0.0, "yawrate", 0.1)
  with pytest.raises(KeyError, match="motor_voltage"):
    FederatedFilter(CAR).update(0.0, "motor_duty", 0.1)
  with pytest.raises(ValueError, match="cannot estimate 'speedscale'; did you mean 'speed_scale'"):
    FilterSettings().estimating("speedscale")
  with pytest.raises(ValueError, match="no car 'twins'; did you mean 'twin'"):
    benchmark_filter.subject("twins", 1)


def test_an_accelerometer_in_mm_per_s2_ends_no_filter():
  """On the sample's figure eight the covariance left the filter's arithmetic after eight seconds."""
  recording = DataSet.load(ROOT / "data" / "sample")["figure_eight"]
  recording = recording.window(recording.start, recording.start + 12.0)
  wrong = Stream(recording["accel_y"].time, 1e3 * recording["accel_y"].value)
  recording = recording.replace(streams={**recording.streams, "accel_y": wrong})
  settings = FilterSettings().with_scores_of([recording]).estimating(*ESTIMATED)
  result = filter_recording(recording, Model.nominal().car, settings)
  assert not result.valid[-400:].all()
  assert all(np.all(std[~np.isnan(std)] >= 0.0) for std in result.std.values())


def test_a_voltage_of_a_million_ends_no_control_loop():
  trip, online = journey(6.0, amplitude=0.4), FederatedFilter(CAR, FilterSettings().estimating(*ESTIMATED))
  trip.commands[200:, 0] *= 1e6
  estimates, _ = run(trip, federated=online)
  assert any(BROKEN in estimate.reasons for estimate in estimates)
  for estimate in estimates:
    assert all(std >= 0.0 for std in estimate.std.values()) and min(estimate.bounds) >= 0.0


def test_a_start_or_a_time_that_is_not_finite_is_refused():
  federated = FederatedFilter(CAR)
  with pytest.raises(ValueError, match="cannot start: y, speed not finite; without `start` it waits for a fix"):
    federated.start(0.0, (0.0, math.nan, 0.0), math.inf)
  with pytest.raises(ValueError, match="standard deviation of 0; it must be positive"):
    federated.start(0.0, (0.0, 0.0, 0.0), std=0.0)
  for time in (math.nan, math.inf):
    with pytest.raises(ValueError, match="the time of the clock that stamps the samples"):
      federated.estimate(time)


@pytest.mark.parametrize(
  "settings", [FilterSettings(), FilterSettings().estimating(*ESTIMATED)], ids=["plain", "states"]
)
def test_samples_that_are_not_finite_are_as_good_as_none(settings):
  """Online they are refused by channel; in a batch infinities are no samples."""
  trip = journey(4.0)
  _, federated = run(trip, settings)
  for channel in ("speed", "yaw_rate", "accel_x", "pose_x", "steering_command"):
    federated.update(4.005, channel, math.inf)
    federated.update(math.nan, channel, 1.0)
    assert federated.refused[channel, "not finite"] == 2
  assert federated.estimate(4.01).valid

  batches = [FederatedBatch(CAR, settings, 2, watched=True) for _ in range(2)]
  none = np.full((2, 2), np.nan)
  for batch, nothing in zip(batches, (math.nan, math.inf), strict=True):
    batch.start(np.zeros((2, 3)), np.full(2, 0.5))
    for k in range(30):
      lost = k % 3 == 0
      batch.command(np.full((2, 2), nothing) if lost else np.tile((0.6, 0.1), (2, 1)))
      batch.advance(np.full((2, 2), nothing) if lost else np.tile((0.5, 0.1), (2, 1)), none)
  for estimate in ("pose", "speed", "covariance"):
    mine, theirs = (getattr(batch.estimate(), estimate) for batch in batches)
    assert np.isfinite(mine).all()
    np.testing.assert_array_equal(mine, theirs)


def test_shapes_of_other_cars_are_refused():
  batch = FederatedBatch(CAR, FilterSettings(), 3)
  right = np.zeros((3, 2))
  with pytest.raises(ValueError, match=r"motion of shape \(2,\); 3 cars have \(3, 2\)"):
    batch.advance(np.zeros(2), right)
  with pytest.raises(ValueError, match=r"fix of shape \(3, 3\); 3 cars have \(3, 4\)"):
    batch.advance(right, right, np.zeros((3, 3)))


def test_one_period_for_filter_and_sensors():
  suite = SensorSuite(qcar_sensors(), 1, 0, period=0.005)
  with pytest.raises(ValueError, match="a filter of a period of 0.01 s on sensors of 0.005 s"):
    SensedObserver(suite, CAR, FilterSettings())
