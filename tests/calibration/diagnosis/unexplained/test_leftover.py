"""What a model leaves over: found where it was put, in the family it follows, and nowhere on noise."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.decision.conclude import above_level, strength
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.unexplained.bursts import bursts
from calibration.diagnosis.unexplained.families import (
  heading,
  histories,
  monomials,
  motion,
  past_commands,
  places,
  terms,
)
from calibration.diagnosis.unexplained.leftover import FAMILIES, leftovers, smooth_gain
from calibration.diagnosis.unexplained.rhythm import excess, spectrum
from tests.calibration.diagnosis import diagnosis_rig as rig


def found(pool, model=None):
  model = model or pool.base
  items = leftovers(model, pool.problem, pool.problem.predict(model.theta[None]))
  return {(item.channel, item.family): item for item in items}


def spoilt(channel, error, pose=True, seed=5):
  """A pool for a faultless car with one sensor that adds error(time, recording number)."""
  twin = rig.LinearTwin()
  recordings = []
  for k, recording in enumerate(rig.measure(twin, rig.drive(seed=seed, pose=pose), {}, seed + 1)):
    stream = recording[channel]
    value = stream.value + error(stream.time, k)
    recordings.append(recording.replace(streams=dict(recording.streams) | {channel: type(stream)(stream.time, value)}))
  return rig.pool_of(rig.problem_of(twin, recordings), mechanisms=())


def test_noise_leaves_nothing_over():
  items = found(rig.session({}, seed=11, pose=True))
  assert {family for _, family in items} == {"motion", "commands", "heading", "place", "history", "rhythm", "bursts"}
  smooth = [i.nats for i in items.values() if i.family not in ("rhythm", "bursts")]
  assert max(smooth) < 0.25
  assert max(i.nats for i in items.values() if i.family == "rhythm") < 2.5  # ten stretches scatter by 0.3 each way


@pytest.mark.parametrize(("family", "columns"), [(heading, 8), (places, 36)])
def test_one_recording_without_a_pose_takes_it_from_no_other(family, columns):
  """What is tied to a place or turns with the heading shows where the pose is known, and says nothing elsewhere."""
  pool = rig.session({}, seed=11, pose=True)
  observations, prediction = pool.problem.observations, pool.problem.predict(pool.base.theta[None])
  segments = observations.stretches.segments
  whole, blind = family(observations, prediction), np.array([name == "run_0" for name in segments.recording])
  lacking = np.where(blind[:, None, None], np.nan, segments.pose)
  stretches = dataclasses.replace(observations.stretches, segments=dataclasses.replace(segments, pose=lacking))
  found = family(dataclasses.replace(observations, stretches=stretches), prediction)
  assert found.shape == whole.shape == (*segments.pose.shape[:2], columns)
  assert not found[blind].any() and found[~blind].any(axis=(1, 2)).all()
  if family is heading:
    assert np.array_equal(found[~blind], whole[~blind])


def test_an_effect_the_model_lacks_is_left_over_until_it_is_modelled(offset_pool):
  before = found(offset_pool)
  after = found(offset_pool, offset_pool.models[frozenset(["steering_offset"])])
  assert before["accel_y", "commands"].nats > 1.0
  assert after["accel_y", "commands"].nats < 0.2 * before["accel_y", "commands"].nats


def test_an_error_that_follows_the_heading_is_found_there():
  # the linear car's pose circles at a tenth of a radian per second, all recordings alike
  items = found(spoilt("yaw_rate", lambda time, k: 0.4 * np.cos(4.0 * time)))
  assert items["yaw_rate", "rhythm"].nats < 3.0  # 0.6 Hz lies below the band
  items = found(spoilt("accel_y", lambda time, k: 1.0 * np.cos(2 * 0.1 * time)))
  own = items["accel_y", "heading"]
  assert own.nats > 0.5 and own.depends_on == ("pose_yaw",)
  assert own.nats == max(i.nats for i in items.values() if i.family == "heading")


def test_the_size_of_a_structure_is_its_share_of_what_the_channel_shows():
  pool = spoilt("accel_y", lambda time, k: 1.0 * np.cos(2 * 0.1 * time))
  own, observations = found(pool)["accel_y", "heading"], pool.problem.observations
  rows = observations.select("accel_y")
  put = np.sqrt(np.mean(np.cos(2 * 0.1 * observations.time[rows]) ** 2)) / np.std(observations.measured[rows])
  assert 0.8 * put < own.size < 1.1 * put
  levels = dataclasses.replace(usual_levels(), material=0.9 * own.size)
  assert (
    above_level([own], levels) == (own,)
    and above_level([own], dataclasses.replace(levels, material=1.1 * own.size)) == ()
  )


def test_a_rhythm_of_unknown_phase_is_found_at_its_frequency():
  items = found(spoilt("yaw_rate", lambda time, k: 0.2 * np.sin(2 * np.pi * 3.2 * time + 1.7 * k)))
  assert items["yaw_rate", "rhythm"].nats > 5.0
  assert items["yaw_rate", "rhythm"].depends_on == ("time: a rhythm of 3.2 Hz",)
  assert items["accel_y", "rhythm"].nats < 2.5


def test_a_rhythm_counts_from_the_size_that_all_structure_counts_from():
  """A line that no noise makes is none that matters: marks of a speed sensor lie as unevenly as they were put on."""
  pool = spoilt("yaw_rate", lambda time, k: 0.2 * np.sin(2 * np.pi * 3.2 * time + 1.7 * k))
  own, observations = found(pool)["yaw_rate", "rhythm"], pool.problem.observations
  put = 0.2 / np.sqrt(2.0) / np.std(observations.measured[observations.select("yaw_rate")])
  assert own.size == pytest.approx(put, rel=0.1)
  levels = dataclasses.replace(usual_levels(), material=0.9 * own.size)
  assert strength(own, levels) > 1.0
  assert strength(own, dataclasses.replace(levels, material=1.1 * own.size)) == 0.0


def test_errors_that_come_in_bursts_are_told_from_errors_that_are_always_there():
  def now_and_then(time, k):  # a quarter of a second in every ten
    return 3.0 * ((time + k) % 10.0 < 0.25)

  items, levels = found(spoilt("yaw_rate", now_and_then)), usual_levels()
  own = items["yaw_rate", "bursts"]
  assert strength(own, levels) > 1.5 and own in above_level([own], levels)
  assert "time: " in own.depends_on[0]
  assert strength(items["accel_y", "bursts"], levels) < 0.5
  always = found(spoilt("yaw_rate", lambda time, k: 0.3 * np.cos(4.0 * time)))
  assert strength(always["yaw_rate", "bursts"], levels) < 0.5


def test_bursts_are_the_share_of_the_strongest_twentieth_while_the_car_moves(clean_pool):
  observations = clean_pool.problem.observations
  prediction = clean_pool.problem.predict(clean_pool.base.theta[None])
  rows = np.flatnonzero(observations.select("yaw_rate"))
  residual = np.zeros(len(observations))
  residual[rows] = 1.0
  even = bursts(residual, observations, prediction, "yaw_rate")
  assert even.windows >= 100 and even.share == pytest.approx(0.05, abs=0.01)
  residual[rows[len(rows) // 2]] = 1e4
  assert bursts(residual, observations, prediction, "yaw_rate").share > 0.99
  resting = type(prediction)(**{**vars(prediction), "signals": 0.0 * prediction.signals})
  assert bursts(residual, observations, resting, "yaw_rate").windows == 0


def test_excess_of_a_line_and_of_white_noise():
  random = np.random.default_rng(0)
  frequencies, time = np.arange(1.0, 12.0, 0.1), np.arange(0.0, 6.0, 0.02)
  noise = np.mean([excess(*spectrum(frequencies, time, random.standard_normal(len(time)))) for _ in range(200)], axis=0)
  assert abs(noise[20:60].mean()) < 0.15  # dividing by an estimate adds a little
  line = excess(*spectrum(frequencies, time, np.sin(2 * np.pi * 4.0 * time) + 0.1 * random.standard_normal(len(time))))
  assert frequencies[int(np.argmax(line))] == pytest.approx(4.0, abs=0.1)
  power, _ = spectrum(frequencies, time, 3.0 * np.sin(2 * np.pi * 4.0 * time + 0.7))
  assert power.max() == pytest.approx(0.5 * 3.0**2, rel=0.02)  # the mean square of the sinusoid


def test_smooth_gain_is_what_ridge_regression_saves_on_data_left_out(offset_pool):
  problem, base = offset_pool.problem, offset_pool.base
  observations = problem.observations
  rows = np.flatnonzero(observations.select("accel_y"))
  features = np.random.default_rng(1).standard_normal((len(rows), 3))
  whitening = problem.whiten(np.ones(len(observations)))
  test = smooth_gain(base.residual, features, observations, "accel_y", whitening)
  columns = features * (0.1 * np.std(observations.measured[rows]) * whitening[rows])[:, None]
  target, group = base.residual[rows], observations.recording[rows]
  left = target.copy()
  for kind in np.unique(group):
    own = group == kind
    gram = columns[~own].T @ columns[~own] + np.eye(3)
    left[own] -= columns[own] @ np.linalg.solve(gram, columns[~own].T @ target[~own])
  assert sum(test.blocks) == pytest.approx(0.5 * (target @ target - left @ left))


def test_a_car_without_a_pose_has_no_heading_and_no_place(clean_pool):
  observations = clean_pool.problem.observations
  prediction = clean_pool.problem.predict(clean_pool.base.theta[None])
  shape = prediction.signals.shape[1:3]
  stretches = observations.stretches
  still = type(stretches.segments)(**{**vars(stretches.segments), "pose": None})
  cut = type(stretches)(still, stretches.first, stretches.last)
  bare = dataclasses.replace(observations, stretches=cut)
  assert heading(bare, prediction).shape == (*shape, 0) == places(bare, prediction).shape
  assert motion(bare, prediction).shape == (*shape, 15)
  assert past_commands(bare, prediction).shape == (*shape, 17)
  assert histories(bare, prediction).shape == (*shape, 24)


def test_families_are_of_order_one_and_said_in_words(offset_pool):
  observations = offset_pool.problem.observations
  prediction = offset_pool.problem.predict(offset_pool.base.theta[None])
  for features, words in FAMILIES.values():
    grid = features(observations, prediction)
    assert np.isfinite(grid).all() and np.abs(grid).max() < 10.0
    assert words and all(words)


def test_monomials_up_to_the_second_degree():
  x, y = np.array([2.0, 3.0]), np.array([5.0, 7.0])
  assert terms(2) == [(), (0,), (1,), (0, 0), (0, 1), (1, 1)]
  np.testing.assert_array_equal(monomials([x, y], terms(2)), [[1, 2, 5, 4, 10, 25], [1, 3, 7, 9, 21, 49]])
