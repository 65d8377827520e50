"""Location: planted seconds and planted circumstances come back; shares are shares."""

from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.circumstances import UNITS, Circumstances, at_values, circumstances
from calibration.diagnosis.locate import (
  evidence_spans,
  locate,
  region_of,
  subsystem_of_unknown,
  torque_law,
  value_evidence,
)
from calibration.diagnosis.region import Condition, Region, find_region
from calibration.diagnosis.unexplained.unknown import unknown_sensors
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.calibration.diagnosis import diagnosis_rig as rig


def test_a_claim_is_located_by_its_own_evidence(offset_pool):
  model = offset_pool.models[frozenset(["steering_offset"])]
  place = locate(offset_pool, model, {"unknown_force_y": 12.0, "unknown_steering": 40.0})
  assert place.source == "claim" and place.subsystem == "steering"
  assert list(place.degrees) == ["steering", "force_y"]
  assert sum(place.channels.values()) == pytest.approx(1.0)
  assert place.channels["yaw_rate"] + place.channels["accel_y"] > 0.95
  drop = 0.5 * (offset_pool.base.residual @ offset_pool.base.residual - model.residual @ model.residual)
  assert place.evidence.sum() == pytest.approx(drop)
  assert 0.7 < sum(s.share for s in place.time) <= 1.0 + 1e-9


def test_nothing_claimed_shows_the_largest_residual(clean_pool):
  place = locate(clean_pool, clean_pool.base)
  assert place.source == "residual" and place.subsystem == "none" and place.degrees == {}
  assert sum(place.channels.values()) == pytest.approx(1.0)


def test_an_unknown_sensor_is_located_in_the_sensor(clean_pool):
  problem, base = clean_pool.problem, clean_pool.base
  whitening = problem.whiten(np.ones(len(problem.observations)))
  rivals = unknown_sensors(base, problem.observations, problem.predict(base.theta[None]), whitening)
  place = locate(clean_pool, base, {"unknown_sensor_accel_y": 3.0}, rivals["unknown_sensor_accel_y"])
  assert place.source == "unknown" and place.subsystem == "sensor" and list(place.degrees) == ["sensor_accel_y"]


def test_a_claimed_bias_is_located_although_every_model_has_it():
  twin = rig.LinearTwin(("gyro_bias",))
  recordings = rig.measure(twin, rig.drive(), {"gyro_bias": 0.2})
  problem = rig.problem_of(twin, recordings)
  base = rig.solved(problem, ("gyro_bias",))
  base.mechanisms = ()  # part of the base, as the sensors' biases are
  pool = rig.Pool(problem=problem, priors=rig.BASE, models={frozenset(): base}, signatures={}, floor=dict(rig.NOISE))
  place = locate(pool, base, claimed=("gyro_bias",))
  assert place.source == "claim" and place.subsystem == "sensor"
  assert place.channels["yaw_rate"] > 0.99
  without = rig.solved(problem)
  assert place.evidence.sum() == pytest.approx(
    0.5 * (without.residual @ without.residual - base.residual @ base.residual), rel=0.2
  )
  assert locate(pool, base).subsystem == "none"


@pytest.mark.parametrize(
  ("name", "subsystem"),
  [("unknown_voltage", "drive"), ("unknown_steering", "steering"), ("unknown_force_y", "tyre"),
   ("unknown_force_x", "body"), ("unknown_sensor_yaw_rate", "sensor")],
)  # fmt: skip
def test_subsystem_of_a_nameless_error(name, subsystem):
  assert subsystem_of_unknown(name) == subsystem


def test_the_seconds_that_carry_the_evidence_come_back(offset_pool):
  observations = offset_pool.problem.observations
  evidence = np.zeros(len(observations))
  chosen = (observations.recording == 3) & (observations.time > 3.05)
  evidence[chosen] = 1.0
  (span,) = evidence_spans(evidence, observations)
  assert span.recording == "run_3"
  assert (span.start, span.end) == pytest.approx((3.0, 6.0), abs=0.11)
  assert span.share == pytest.approx(1.0)


def test_neighbouring_blocks_merge_and_strong_ones_come_first(offset_pool):
  observations = offset_pool.problem.observations
  evidence = np.where(observations.recording == 2, 1.0, 0.0) + np.where(observations.recording == 5, 0.4, 0.0)
  spans = evidence_spans(evidence, observations, carries=1.0)
  assert [s.recording for s in spans] == ["run_2", "run_5"]
  assert spans[0].end - spans[0].start > 5.5
  assert sum(s.share for s in spans) == pytest.approx(1.0)


def test_no_evidence_no_seconds(offset_pool):
  observations = offset_pool.problem.observations
  assert evidence_spans(np.full(len(observations), -1.0), observations) == ()


def test_evidence_without_a_model_is_what_exceeds_the_sensor(clean_pool):
  evidence = value_evidence(clean_pool, None)
  # the car is right and its weights are the sensors' noise, so nothing exceeds it on average
  assert abs(evidence.mean()) < 0.05
  assert np.allclose(evidence, 0.5 * (clean_pool.base.residual**2 - 1.0))


def scatter(count=4000, seed=0):
  random = np.random.default_rng(seed)
  features = np.column_stack([random.uniform(0, 3, count), random.uniform(0, 5, count), random.uniform(-1, 1, count)])
  return features, ("speed", "abs(accel_y)", "drive_torque"), np.repeat(np.arange(count // 40), 40)


def test_a_planted_region_comes_back_as_a_rule():
  features, names, block = scatter()
  inside = (features[:, 0] > 1.2) & (features[:, 1] > 3.0)
  evidence = np.where(inside, 1.0, 0.0) + 0.1 * np.random.default_rng(1).standard_normal(len(features))
  region = find_region(features, names, UNITS, evidence, block)
  assert {(c.feature, c.above) for c in region.conditions} == {("speed", True), ("abs(accel_y)", True)}
  bounds = {c.feature: c.value for c in region.conditions}
  assert bounds["speed"] == pytest.approx(1.2, abs=0.06) and bounds["abs(accel_y)"] == pytest.approx(3.0, abs=0.06)
  assert region.share > 0.9
  assert region.samples == pytest.approx(inside.mean(), abs=0.05)
  assert " and " in region.rule and "speed > 1.2" in region.rule


def test_evidence_everywhere_has_no_region():
  features, names, block = scatter()
  region = find_region(features, names, UNITS, np.ones(len(features)), block)
  assert region.rule == "everywhere" and region.share == region.samples == 1.0


def test_a_rule_that_only_fits_its_own_blocks_earns_no_share():
  features, names, block = scatter(800)
  evidence = np.random.default_rng(3).standard_normal(len(features)) + 0.05
  region = find_region(features, names, UNITS, evidence, block)
  assert region.share <= 1.0  # counted on blocks that did not grow the tree
  assert find_region(features[:60], names, UNITS, evidence[:60], block[:60]).rule == "everywhere"


def test_rules_are_short_and_redundant_bounds_are_dropped():
  features, names, block = scatter()
  evidence = np.where(features[:, 0] > 2.5, 1.0, 0.0)
  region = find_region(features, names, UNITS, evidence, block)
  assert region.rule == "speed > 2.5"


def test_conditions_read_as_they_are_meant():
  above, below = Condition("speed", True, 1.5), Condition("speed", False, 1.5)
  values = np.array([1.0, 1.5, 2.0])
  assert above.holds(values).tolist() == [False, False, True]
  assert below.holds(values).tolist() == [True, True, False]
  assert Region((below,), UNITS, 1.0, 0.5).rule == "speed <= 1.5"


def test_region_of_values_uses_moments_of_driving(offset_pool):
  observations = offset_pool.problem.observations
  prediction = offset_pool.problem.predict(offset_pool.base.theta[None])
  around = circumstances(observations, prediction, 1.0, 0.0)
  segments = observations.stretches.segments
  voltage = np.abs(segments.commands[..., 0]).reshape(len(segments), -1)
  flat = np.concatenate([voltage, voltage[:, -1:]], axis=1).reshape(-1)[observations.grid_points]
  region = region_of(np.where(flat > 2.0, 1.0, 0.0), observations, around)
  assert region.conditions and region.share > 0.8 and region.samples < 0.6
  assert {c.feature for c in region.conditions} <= {"abs(drive_command)", "drive_torque", "accel_x", "speed"}


def test_circumstances_are_what_they_say(offset_pool):
  observations = offset_pool.problem.observations
  prediction = offset_pool.problem.predict(offset_pool.base.theta[None])
  around = circumstances(observations, prediction, 2.0, 0.1)
  segments = observations.stretches.segments
  assert set(around.names) <= set(UNITS)
  volts = segments.commands[0, 100, 0]
  spinning = prediction.channel("motor_speed")[0, 0, 100]
  assert around.features["drive_torque"][0, 100] == pytest.approx(2.0 * volts - 0.1 * spinning)
  assert around.features["time"][0, 250] == pytest.approx(2.5)
  rate = np.abs(segments.commands[0, 300, 1] - segments.commands[0, 280, 1]) / 0.2
  assert around.features["abs(steering_rate)"][0, 300] == pytest.approx(rate)
  assert np.allclose(around.features["pose_x"], segments.pose[..., 0])


@pytest.mark.parametrize("drive", ["voltage", "duty", "current", "speed"])
def test_drive_torque_is_that_of_the_cars_own_command(drive):
  vehicle = Vehicle(drive=drive, supply_voltage=8.0)
  parameters = Twin(vehicle, threads=1).parameters
  strength, damping = torque_law(vehicle, parameters.named(parameters.nominal))
  assert strength == pytest.approx((8.0 if drive == "duty" else 1.0) * vehicle.torque_per_command) and strength > 0.0
  assert damping == pytest.approx(vehicle.motor_damping)


def test_displacements_see_the_mean_over_their_horizon():
  grid = np.arange(2 * 301, dtype=float).reshape(2, 301, 1)
  index = rig.CHANNELS.index("pose_forward")
  observations = SimpleNamespace(
    channel=np.array([index, index]), grid_points=np.array([200, 301 + 50]), horizon=1.0,
    stretches=SimpleNamespace(segments=SimpleNamespace(period=0.01)),
  )  # fmt: skip
  values = at_values(grid, observations, "pose_forward")[:, 0]
  assert values[0] == pytest.approx(np.mean(np.arange(100, 201)))
  assert values[1] == pytest.approx(np.mean(np.arange(301, 352)))  # never across the segment's start
  assert Circumstances({"speed": grid[..., 0]}, 0.01).stacked().shape == (2, 301, 1)
