"""Detectors: quiet on noise, each woken by what it is for, with numbers that have a closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.detect import LEVELS, detect, drift, horizon_conflict, predicted_share, prior_conflict
from calibration.fitting.noise import ChannelNoise
from calibration.fitting.windows import Stretches
from qcar_twin.plant import SIGNALS, Prediction, Segments
from tests.calibration.diagnosis import diagnosis_rig as rig


def detection(pool):
  return detect(rig.baseline_of(pool.problem, pool.base), pool.base)


def test_all_quiet_without_an_effect(clean_pool):
  found = detection(clean_pool)
  assert [d.name for d in found.detectors] == list(LEVELS)
  assert not found.alarm
  assert found["predictability"].statistic < 0.02
  assert found["drift"].statistic == pytest.approx(1.0, abs=0.6)


def test_an_effect_leaves_predictable_residuals(offset_pool):
  found = detection(offset_pool)
  assert found.alarm
  sign = found["predictability"]
  assert sign.alarm and sign.statistic > LEVELS["predictability"]
  assert "yaw_rate" in sign.sentence or "accel_y" in sign.sentence
  assert all(d.sentence.endswith(".") for d in found.detectors)


def test_predicted_share_is_the_share_of_variance_that_follows():
  random = np.random.default_rng(0)
  features = random.standard_normal((6000, 4))
  group = np.repeat(np.arange(10), 600)
  target = features @ [1.0, 0.0, 0.0, 0.0] + 2.0 * random.standard_normal(6000)
  assert predicted_share(features, target, group) == pytest.approx(0.2, abs=0.03)
  assert abs(predicted_share(features, random.standard_normal(6000), group)) < 0.01


def test_what_holds_in_one_recording_only_is_not_predictable():
  random = np.random.default_rng(1)
  features = random.standard_normal((4000, 2))
  group = np.repeat(np.arange(4), 1000)
  sign = np.where(group % 2 == 0, 1.0, -1.0)  # each recording contradicts its neighbour
  target = sign * features[:, 0] + 0.1 * random.standard_normal(4000)
  assert predicted_share(features, target, group) < 0.02


def test_one_group_or_no_residual_is_no_evidence():
  features = np.ones((10, 1))
  assert predicted_share(features, np.ones(10), np.zeros(10, dtype=int)) == 0.0
  assert predicted_share(features, np.zeros(10), np.arange(10)) == 0.0


def test_drift_names_the_parameter_and_the_recordings():
  twin = rig.LinearTwin()
  runs = rig.drive()
  normal, other = rig.measure(twin, runs, {}), rig.measure(twin, runs, {"cornering_stiffness_front": 6.0})
  mixed = [*normal[:2], other[2], *normal[3:]]
  pool = rig.pool_of(rig.problem_of(twin, mixed), mechanisms=())
  statistic, (alarm, _) = drift(pool.base, pool.problem.observations)
  assert statistic > LEVELS["drift"]
  assert "cornering_stiffness_front" in alarm and "'run_2'" in alarm
  calm, _ = drift(rig.solved(rig.problem_of(twin, normal)), pool.problem.observations)
  assert calm < 2.0


def test_a_measured_parameter_that_moved_is_named():
  twin = rig.LinearTwin()
  heavy = rig.LinearTwin()
  recordings = rig.measure(heavy, rig.drive(), {"mass": 3.8}, noise=0.2)
  base = rig.solved(rig.problem_of(twin, recordings))
  statistic, (alarm, _) = prior_conflict(base)
  assert statistic > LEVELS["priors"]
  assert alarm.startswith("mass was measured as 2.7 kg")


@pytest.mark.parametrize(
  ("informed", "expected"), [(0.99, 6.0 / 0.99**0.5), (0.6, 6.0 / 0.6**0.5), (0.1, 6.0 / 0.5**0.5)]
)
def test_a_shift_of_what_the_data_hardly_inform_is_not_blown_up(clean_pool, informed, expected):
  """Share of the mass's prior variance that the data take away; with less than a twentieth it is not asked."""
  base = rig.solved(clean_pool.problem)
  i, std = base.free.index("mass"), base.free["mass"].std
  values, stds = base.values.copy(), base.std.copy()
  values[i], stds[i] = base.free["mass"].nominal + 6.0 * std, std * np.sqrt(1.0 - informed)
  shifted = SimpleNamespace(free=base.free, values=values, std=stds)
  assert prior_conflict(shifted)[0] == pytest.approx(expected)
  stds[i] = std * np.sqrt(0.96)
  assert prior_conflict(shifted)[0] < 1.5


def test_no_measured_parameter_no_conflict(clean_pool):
  base = rig.solved(clean_pool.problem)
  index = [i for i, p in enumerate(base.free) if p.std is None]
  free = type(base.free)(p for p in base.free if p.std is None)
  bare = SimpleNamespace(free=free, values=base.values[index], std=base.std[index])
  assert prior_conflict(bare)[0] == 0.0


def poses(error, noise=0.0, seed=0, segments=8, length=600):
  """Observations of straight driving at 1 m/s whose prediction is off by `error` (S, T + 1) to the side."""
  random = np.random.default_rng(seed)
  time = 0.01 * np.arange(length + 1)
  truth = np.zeros((segments, length + 1, 3))
  truth[..., 0] = time
  signals = np.zeros((1, segments, length + 1, len(SIGNALS)))
  signals[0, ..., 0] = time
  signals[0, ..., 1] = error
  measured = truth + noise * random.standard_normal(truth.shape) * [1.0, 1.0, 0.0]
  names = tuple(f"run_{k}" for k in range(segments))
  parts = Segments(np.zeros((segments, length, 2)), np.zeros((segments, 7)), np.full(segments, length), 0.01, names,
                   np.zeros(segments), pose=measured)  # fmt: skip
  stretches = Stretches(parts, np.zeros(segments), np.full(segments, 0.01 * length))
  passport = {n: ChannelNoise(s, 0.0, "standstill", 0.0, 0.0, 100.0, 0.01)
              for n, s in (("pose_x", noise), ("pose_y", noise), ("pose_yaw", 0.0))}  # fmt: skip
  return SimpleNamespace(stretches=stretches), Prediction(signals, 0.01), passport


def test_a_steady_error_grows_in_proportion_to_time():
  time = 0.01 * np.arange(601)
  statistic, (alarm, _) = horizon_conflict(*poses(0.05 * time[None] * np.linspace(0.5, 1.5, 8)[:, None]))
  assert statistic == pytest.approx(1.0, abs=1e-6)
  assert "pose_left" in alarm
  assert statistic > LEVELS["horizons"]


def test_random_pushes_grow_with_the_root_of_time():
  random = np.random.default_rng(2)
  walk = np.cumsum(0.003 * random.standard_normal((8, 601)), axis=1)
  statistic, _ = horizon_conflict(*poses(walk))
  assert statistic == pytest.approx(0.5, abs=0.15)


def test_the_noise_of_the_pose_is_taken_off():
  time = 0.01 * np.arange(601)
  slope = 0.05 * time[None] * np.linspace(0.5, 1.5, 8)[:, None]
  statistic, _ = horizon_conflict(*poses(slope, noise=0.01))
  assert statistic == pytest.approx(1.0, abs=0.2)
  quiet, (_, calm) = horizon_conflict(*poses(np.zeros((8, 601)), noise=0.01))
  assert quiet <= 1.0 and calm


def test_no_pose_no_verdict():
  observations, prediction, _ = poses(np.zeros((8, 601)))
  statistic, (_, calm) = horizon_conflict(observations, prediction, {})
  assert statistic == 0.0 and "no pose" in calm
