"""Rates, latencies, dropouts, faults and random streams of the sensors; the encoder's counts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qcar_twin.plant import SIGNALS
from qcar_twin.sensors.base import Timing
from qcar_twin.sensors.faults import Fault, FaultRun
from qcar_twin.sensors.noise import ChannelNoise
from qcar_twin.sensors.onboard import Encoder, Imu
from qcar_twin.sensors.statistical_lidar import StatisticalLidar
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors

QUIET = Imu(accel=ChannelNoise(), gyro=ChannelNoise())


def signals(count=1, **values):
  out = np.zeros((count, len(SIGNALS)))
  for name, value in values.items():
    out[:, SIGNALS.index(name)] = value
  return out


def collect(suite, steps, now=None):
  """All readings by first channel: (step of arrival, age, values)."""
  readings = {}
  for k in range(steps):
    for reading in suite.measure(signals(suite.count) if now is None else now(k)):
      readings.setdefault(reading.channels[0], []).append((k, reading.age, reading.values))
  return readings


def test_each_sensor_has_its_own_rate_and_latency():
  sensors = {"imu": QUIET, "lidar": StatisticalLidar(Timing(rate=10.0, latency=0.05, dropout=0.0))}
  samples = collect(SensorSuite(sensors, 1, 0), 101)
  assert [k for k, _, _ in samples["accel_x"]] == list(range(101)) and {age for _, age, _ in samples["accel_x"]} == {0}
  assert [k for k, _, _ in samples["pose_x"]] == list(range(5, 101, 10))
  assert {age for _, age, _ in samples["pose_x"]} == {5}


def test_a_late_reading_holds_what_was_true_when_it_was_measured():
  lidar = StatisticalLidar(Timing(10.0, 0.05, 0.0), correlation=0.1, spike_chance=0.0)
  sensors = {"lidar": lidar}
  samples = collect(SensorSuite(sensors, 1, 0), 60, now=lambda k: signals(pose_x=0.01 * k))
  for k, age, values in samples["pose_x"]:
    assert values[0, 0] == pytest.approx(0.01 * (k - age), abs=0.06)


def test_a_rate_that_does_not_divide_the_control_rate_is_refused():
  with pytest.raises(ValueError, match="does not divide"):
    SensorSuite({"imu": Imu(Timing(rate=30.0))}, 1, 0)


def test_dropouts_are_as_frequent_as_said_and_lose_the_whole_sample():
  suite = SensorSuite({"imu": Imu(Timing(dropout=0.2))}, 50, 0)
  values = np.array([v for _, _, v in collect(suite, 200)["accel_x"]])
  lost = np.isnan(values)
  assert lost.all(axis=-1).mean() == pytest.approx(0.2, abs=0.01)
  np.testing.assert_array_equal(lost.any(axis=-1), lost.all(axis=-1))


def test_a_seed_reproduces_a_run_and_another_does_not():
  runs = [collect(SensorSuite(qcar_sensors(), 4, seed), 50) for seed in (3, 3, 4)]
  for name in runs[0]:
    first, again, other = (np.array([v for _, _, v in run[name]]) for run in runs)
    np.testing.assert_array_equal(first, again)
    if name != "motor_speed":
      assert not np.array_equal(first, other)


def test_leaving_one_sensor_out_does_not_touch_the_others():
  everything = collect(SensorSuite(qcar_sensors(), 2, 3), 40)
  fewer = collect(SensorSuite({k: v for k, v in qcar_sensors().items() if k != "imu"}, 2, 3), 40)
  for name in fewer:
    np.testing.assert_array_equal([v for _, _, v in everything[name]], [v for _, _, v in fewer[name]])


def test_restart_throws_away_what_is_under_way():
  suite = SensorSuite({"lidar": StatisticalLidar(Timing(10.0, 0.05, 0.0))}, 2, 0)
  suite.measure(signals(2))
  suite.restart(np.array([True, False]), signals(2))
  samples = collect(suite, 6)["pose_x"][0][2]
  assert np.isnan(samples[0]).all() and np.isfinite(samples[1]).all()


# -- encoder -------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [10.0, 50.0, 100.0])
def test_an_encoder_that_samples_seldom_says_the_speed_from_its_first_sample_on(rate):
  """At its beginning and after a restart at another speed it has not counted for a whole interval yet."""
  suite = SensorSuite({"encoder": Encoder(Timing(rate=rate))}, 2, 0)
  said = []
  for k in range(46):
    motor = np.array([100.0, 100.0 if k < 24 else -30.0])
    if k == 24:
      suite.restart(np.array([False, True]), signals(2, motor_speed=motor))
    said += [(k, reading.values[:, 0]) for reading in suite.measure(signals(2, motor_speed=motor))]
  step = 2.0 * np.pi / 2880 * rate  # of a count
  for k, speed in said:
    assert speed == pytest.approx([100.0, 100.0 if k < 24 else -30.0], abs=1.01 * step)


@settings(max_examples=30, deadline=None)
@given(st.floats(-400.0, 400.0), st.integers(0, 1000))
def test_encoder_counts_are_whole_and_lose_nothing(speed, seed):
  """Every sample is a whole number of counts, and their sum is the angle turned, to one count."""
  suite = SensorSuite({"encoder": Encoder()}, 1, seed)
  values = np.array(
    [v[0, 0] for _, _, v in collect(suite, 200, now=lambda k: signals(motor_speed=speed))["motor_speed"]]
  )
  count = 2 * np.pi / 2880 / 0.01  # rad/s per count and period
  np.testing.assert_allclose(values / count, np.round(values / count), atol=1e-6)
  assert abs(values.sum() - 200 * speed) < 1.01 * count


def test_encoder_at_rest_says_exactly_zero():
  assert all(v[0, 0] == 0.0 for _, _, v in collect(SensorSuite({"encoder": Encoder()}, 1, 0), 50)["motor_speed"])


def test_a_slower_encoder_averages_over_its_interval():
  suite = SensorSuite({"encoder": Encoder(Timing(rate=20.0))}, 1, 0)
  samples = collect(suite, 51, now=lambda k: signals(motor_speed=float(k)))["motor_speed"]
  assert [k for k, _, _ in samples] == [0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50]
  assert samples[5][2][0, 0] == pytest.approx(22.5, abs=0.1)  # mean of 20 .. 25


def test_imu_reports_what_the_plant_feels():
  reading = SensorSuite({"imu": QUIET}, 1, 0).measure(signals(accel_x=0.3, accel_y=-0.4, yaw_rate=1.2))[0]
  assert reading.values[0] == pytest.approx([0.3, -0.4, 1.2])


# -- statistical lidar ---------------------------------------------------------------------------


def test_errors_have_the_size_the_score_tells_and_the_colour_said():
  lidar = StatisticalLidar(Timing(10.0, 0.0, 0.0), spike_chance=0.0, score_spread=0.5)
  values = np.array([v for _, _, v in collect(SensorSuite({"lidar": lidar}, 100, 0), 3000)["pose_x"]])  # (T, N, 4)
  error, score = values[..., :3], values[..., 3]
  whitened = error[..., 0] / np.sqrt(lidar.position.of(score))
  assert np.std(whitened) == pytest.approx(1.0, rel=0.05)
  assert np.std(error[..., 2] / np.sqrt(lidar.yaw.of(score))) == pytest.approx(1.0, rel=0.05)
  colour = np.mean(whitened[1:] * whitened[:-1])
  assert colour == pytest.approx(lidar.coloured**2 * np.exp(-0.1 / lidar.correlation), abs=0.03)
  assert np.median(score) == pytest.approx(80.0, rel=0.05)


def test_spikes_are_half_a_metre_in_any_direction():
  lidar = StatisticalLidar(Timing(10.0, 0.0, 0.0), spike_chance=0.05)
  values = np.array([v for _, _, v in collect(SensorSuite({"lidar": lidar}, 100, 0), 2000)["pose_x"]])
  far = np.hypot(values[..., 0], values[..., 1])
  assert (far > 0.3).mean() == pytest.approx(0.05, rel=0.1)
  angle = np.arctan2(values[..., 1], values[..., 0])[far > 0.3]
  assert np.hypot(np.cos(angle).mean(), np.sin(angle).mean()) < 0.1
  assert far[far > 0.3] == pytest.approx(0.5, abs=0.1)


# -- faults --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
  ("fault", "expected"),
  [
    (Fault("accel_x", "offset", 0.1, 0.2, 1.0), 1.3),
    (Fault("accel_x", "stuck", 0.1, 0.2, -7.0), -7.0),
    (Fault("accel_x", "lost", 0.1, 0.2), np.nan),
    (Fault("accel_x", "not_finite", 0.1, 0.2), np.inf),
  ],
)
def test_faults_act_on_their_channel_in_their_time(fault, expected):
  suite = SensorSuite({"imu": QUIET}, 1, 0, faults=(fault,))
  samples = collect(suite, 30, now=lambda k: signals(accel_x=0.3, yaw_rate=0.5))["accel_x"]
  column = np.array([v[0, 0] for _, _, v in samples])
  np.testing.assert_array_equal(column[10:20], np.full(10, expected))
  np.testing.assert_array_equal(np.concatenate([column[:10], column[20:]]), np.full(20, 0.3))
  assert all(v[0, 2] == 0.5 for _, _, v in samples)


def test_unknown_fault_lists_the_kinds():
  with pytest.raises(ValueError, match="offset, stuck, frozen, lost, not_finite, spikes, late, late_unsaid"):
    Fault("accel_x", "wobble", 0.0)  # type: ignore[arg-type]


def test_a_frozen_channel_repeats_the_sample_before():
  suite = SensorSuite({"imu": QUIET}, 2, 0, faults=(Fault("accel_x", "frozen", 0.1, 0.2),))
  samples = collect(suite, 30, now=lambda k: signals(2, accel_x=0.01 * k))["accel_x"]
  column = np.array([v[:, 0] for _, _, v in samples])
  np.testing.assert_array_equal(column[9:20], np.tile(column[9], (11, 1)))
  assert column[20, 0] == pytest.approx(0.2)


def test_a_frozen_channel_repeats_each_cars_last_sample_over_a_dropout():
  run = FaultRun(Fault("yaw_rate", "frozen", 0.2), np.random.default_rng(0))
  for time, said in ((0.0, [1.0, 2.0]), (0.1, [np.nan, 3.0])):
    run.apply(("yaw_rate",), time, np.array(said)[:, None])
  np.testing.assert_array_equal(run.apply(("yaw_rate",), 0.2, np.array([[5.0], [np.nan]]))[:, 0], [1.0, 3.0])


def test_spikes_hit_their_share_of_the_samples_either_way():
  suite = SensorSuite({"imu": QUIET}, 50, 0, faults=(Fault("accel_x", "spikes", 0.0, size=2.0, chance=0.3),))
  samples = np.array([v[:, 0] for _, _, v in collect(suite, 200)["accel_x"]])
  assert np.isin(np.round(np.abs(samples), 9), (0.0, 2.0)).all()
  assert (samples > 1.0).mean() == pytest.approx(0.15, abs=0.01) and (samples < -1.0).mean() == pytest.approx(
    0.15, abs=0.01
  )


@pytest.mark.parametrize(("kind", "ages"), [("late", {5, 10}), ("late_unsaid", {5})])
def test_a_late_fix_says_its_age_or_not(kind, ages):
  lidar = StatisticalLidar(Timing(10.0, 0.05, 0.0), spike_chance=0.0)
  suite = SensorSuite({"lidar": lidar}, 1, 0, faults=(Fault("pose_x", kind, 1.0, 2.0, 0.05),))
  heard = [(k, r.age) for k in range(300) for r in suite.measure(signals()) if "pose_x" in r.channels]
  assert {age for _, age in heard} == ages
  periods = [k % 10 for k, _ in heard]
  assert periods == [5] * 10 + [0] * 10 + [5] * (len(heard) - 20)


def test_nothing_arrives_before_it_was_measured():
  with pytest.raises(ValueError, match="before it was measured"):
    Fault("pose_x", "late", 0.0, size=-0.1)
