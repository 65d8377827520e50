"""Noise: what is put in comes out, and a standstill recording tells it."""

import math

import numpy as np
import pytest

from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from qcar_twin.sensors.noise import ChannelNoise, ErrorStream, channel_noise, standstill_noise
from qcar_twin.sensors.score import ScoreVariance


def series(noise, length, interval, count=1, seed=0):
  stream = ErrorStream((noise,), count, interval, np.random.default_rng(seed))
  return np.array([stream.sample()[:, 0] for _ in range(length)])  # (k, N)


def test_white_noise_is_white():
  errors = series(ChannelNoise(white=0.3), 4000, 0.01)[:, 0]
  assert np.std(errors) == pytest.approx(0.3, rel=0.05)
  assert abs(np.corrcoef(errors[1:], errors[:-1])[0, 1]) < 0.06


def test_coloured_noise_is_stationary_from_the_first_sample_and_decays_as_said():
  errors = series(ChannelNoise(coloured=0.008, correlation=0.3), 400, 0.1, count=400)
  assert np.std(errors[0]) == pytest.approx(0.008, rel=0.12)
  assert np.std(errors) == pytest.approx(0.008, rel=0.03)
  lag = np.mean(errors[3:] * errors[:-3]) / np.var(errors)
  assert lag == pytest.approx(math.exp(-1.0), abs=0.03)


def test_bias_is_constant_in_a_run_and_differs_between_runs():
  errors = series(ChannelNoise(bias=0.05), 20, 0.01, count=500)
  assert np.ptp(errors, axis=0).max() == 0.0
  assert np.std(errors[0]) == pytest.approx(0.05, rel=0.12)


def test_walk_grows_with_the_square_root_of_time():
  errors = series(ChannelNoise(walk=0.02), 1000, 0.01, count=300)
  assert np.std(errors[-1]) == pytest.approx(0.02 * math.sqrt(10.0), rel=0.12)


def test_spikes_come_as_often_and_as_large_as_said():
  errors = series(ChannelNoise(spike_chance=0.02, spike_size=0.5), 20000, 0.1)[:, 0]
  hits = errors != 0.0
  assert hits.mean() == pytest.approx(0.02, rel=0.2)
  assert 0.25 <= np.abs(errors[hits]).min() and np.abs(errors[hits]).max() <= 0.5
  assert abs(np.mean(np.sign(errors[hits]))) < 0.15


def test_restarting_one_run_leaves_the_others_alone():
  noise = (ChannelNoise(white=0.1, bias=1.0, coloured=0.2, walk=0.1),)
  one, two = (ErrorStream(noise, 3, 0.01, np.random.default_rng(0)) for _ in range(2))
  one.restart(np.array([False, True, False]))
  two.restart(np.zeros(3, dtype=bool))
  a, b = one.sample(), two.sample()
  assert a[1] != b[1]
  np.testing.assert_array_equal(a[[0, 2]], b[[0, 2]])


def test_negative_noise_is_refused():
  with pytest.raises(ValueError, match="cannot be negative"):
    ChannelNoise(white=-0.1)


# -- measured at standstill ----------------------------------------------------------------------


@pytest.mark.parametrize(
  ("noise", "interval", "length"),
  [
    (ChannelNoise(white=0.15, walk=0.003), 0.01, 20000),
    (ChannelNoise(white=0.01, walk=0.0003), 0.01, 20000),
    (ChannelNoise(white=0.05, walk=0.02), 0.01, 20000),
  ],
)
def test_white_noise_and_walk_are_told_apart(noise, interval, length):
  estimate = channel_noise(interval * np.arange(length), 0.4 + series(noise, length, interval)[:, 0])
  assert estimate.white == pytest.approx(noise.white, rel=0.05)
  assert estimate.walk == pytest.approx(noise.walk, rel=0.6)
  assert estimate.coloured == 0.0 and math.isnan(estimate.correlation)
  assert estimate.offset == pytest.approx(0.4, abs=0.3) and estimate.interval == pytest.approx(interval)


def test_correlated_errors_of_a_lidar_are_recognised():
  noise = ChannelNoise(white=0.003, coloured=0.008, correlation=0.4)
  estimate = channel_noise(0.1 * np.arange(6000), series(noise, 6000, 0.1)[:, 0])
  assert estimate.coloured == pytest.approx(0.008, rel=0.1)
  assert estimate.correlation == pytest.approx(0.4, rel=0.2)
  assert estimate.white == pytest.approx(0.003, rel=0.3)
  assert estimate.std == pytest.approx(math.hypot(0.003, 0.008), rel=0.05)


def still(name="still", **value):
  time = 0.01 * np.arange(2000)
  return Recording(name, {channel: Stream(time, v) for channel, v in value.items()})


def test_standstill_recording_gives_every_channel_with_samples():
  rng = np.random.default_rng(0)
  recording = still(
    yaw_rate=0.003 + 0.01 * rng.normal(size=2000), accel_y=0.1 * rng.normal(size=2000), motor_voltage=np.zeros(2000)
  )
  estimate = standstill_noise(recording)
  assert set(estimate) == {"yaw_rate", "accel_y"}
  assert estimate["yaw_rate"].white == pytest.approx(0.01, rel=0.05)
  assert estimate["yaw_rate"].offset == pytest.approx(0.003, abs=1e-3)


def test_a_quantised_encoder_at_rest_has_no_noise():
  estimate = standstill_noise(still(motor_speed=np.zeros(2000)))
  assert estimate["motor_speed"].std == 0.0


def test_a_moving_car_is_no_standstill():
  with pytest.raises(RecordingError, match="speed changes"):
    standstill_noise(still(speed=np.linspace(0.0, 0.5, 2000)))


def test_too_short_a_recording_is_refused():
  recording = Recording("short", {"yaw_rate": Stream(np.arange(50.0), np.zeros(50))})
  with pytest.raises(RecordingError, match="a minute of standstill"):
    standstill_noise(recording)


# -- score ---------------------------------------------------------------------------------------


def test_score_variance_is_the_papers_formula_and_falls_with_the_score():
  curve = ScoreVariance(1e-3, 30.0, 1.5, 1.2e-3)
  assert curve(40.0) == pytest.approx(1e-3 * math.tanh(30.0 / 40.0 - 1.5) + 1.2e-3)
  scores = np.array([0.0, 1.0, 5.0, 20.0, 50.0, 90.0, 1e9])
  variance = curve.of(scores)
  assert np.all(np.diff(variance) <= 0.0) and np.all(variance > 0.0)
  assert [curve(s) for s in scores] == pytest.approx(variance)
  assert variance[0] == pytest.approx(2.2e-3) and variance[-1] == pytest.approx(1.2e-3 - 1e-3 * math.tanh(1.5))


def test_score_variance_between_two_sizes():
  curve = ScoreVariance.between(0.004, 0.04, 20.0, 2.0)
  assert math.sqrt(curve(1e12)) == pytest.approx(0.004, rel=1e-6)
  assert math.sqrt(curve(0.0)) == pytest.approx(0.04)
  assert curve.times(4.0)(30.0) == pytest.approx(4.0 * curve(30.0))


def test_score_variance_is_recovered_from_errors():
  rng = np.random.default_rng(1)
  truth = ScoreVariance.between(0.006, 0.05, 20.0)
  scores = 60.0 * np.exp(0.7 * rng.normal(size=6000))
  estimate = ScoreVariance.fit(scores, np.sqrt(truth.of(scores)) * rng.normal(size=6000))
  for score in np.quantile(scores, [0.05, 0.25, 0.5, 0.75, 0.95]):
    assert estimate(score) == pytest.approx(truth(score), rel=0.2)


def test_score_variance_needs_positive_variance_and_enough_data():
  with pytest.raises(ValueError, match="k4 > k1 tanh"):
    ScoreVariance(1.0, 1.0, 1.0, 0.5)
  with pytest.raises(ValueError, match="at least 50"):
    ScoreVariance.fit(np.ones(10), np.ones(10))
