"""Claims and verdicts: a right name is claimed and leaves nothing over, a wrong one or none does not pass."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.decision.claims import beyond_usual, sensor_claims
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.conclude import above_level, conclude, judged, strength
from calibration.diagnosis.decision.evidence import Evidence, Measured, Model, Named
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.decision.structure import Leftover
from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.search.gather import errors_left, gather, what_is_left
from calibration.diagnosis.search.weighing import stretched
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.mechanisms.base import SensorError
from tests.calibration.diagnosis import diagnosis_rig as rig
from tests.calibration.diagnosis.decision.test_ties import renamed
from tests.calibration.diagnosis.diagnosis_results import EASY, claimed_of, concluded, decided


def test_a_right_name_is_claimed_and_leaves_nothing_over(offset_pool):
  decision = concluded(offset_pool, decided(offset_pool))
  assert [c.mechanism for c in decision.claims] == ["steering_offset"]
  assert decision.verdict == "explained" and decision.leftovers == ()
  assert decision.claims[0].parameters["steering_offset"]["value"] == pytest.approx(0.03, rel=0.2)
  assert decision.claims[0].probability > 0.8


def test_a_claim_and_what_it_is_ranked_with_count_alike(offset_pool):
  """Both by how much better the recordings are fitted: no name explains more than the twin without it gets wrong."""
  noisy = 0.3  # weights of a search come from what its best model leaves, so that the base is far above them
  weights = dataclasses.replace(offset_pool.problem.weighting, std=noisy * offset_pool.problem.weighting.std)
  pool = rig.pool_of(offset_pool.problem.reweighted(weights))
  right = pool.models[frozenset(["steering_offset"])]
  decision = decided(pool)
  assert [c.mechanism for c in decision.claims] == ["steering_offset"]
  assert decision.claims[0].evidence_nats == pytest.approx(pool.base.cost - right.cost, rel=1e-5)
  assert (
    decision.claims[0].evidence_nats < pool.base.cost and decision.ranking[0][1] == decision.claims[0].evidence_nats
  )


def test_a_clean_car_gets_no_claim(clean_pool):
  decision = concluded(clean_pool, decided(clean_pool))
  assert decision.claims == () and decision.verdict == "no_mismatch"
  assert decision.mechanisms == ()


def test_without_the_right_name_the_mismatch_is_unexplained(offset_pool):
  nameless = dataclasses.replace(offset_pool, models={frozenset(): offset_pool.base})
  decision = decided(nameless)
  assert decision.claims == ()
  decision = concluded(nameless, decision)
  assert decision.verdict == "unexplained"
  assert decision.leftovers[0].channel in ("accel_y", "yaw_rate")


def smooth(size, t=4.0, blocks=36):
  """Structure of a channel that is a function of the motion, of a share of its spread."""
  return Leftover("accel_y", "motion", ("speed",), 2.0, t, blocks, size)


def said(decision, before, after):
  """The verdict on a decision where the recalibrated twin and the model behind the claims leave something."""
  evidence = Evidence("linear car", (Model((), 0.0),), ()).with_left((), before)
  return conclude(decision, evidence.with_left(decision.mechanisms, after), usual_levels())


def test_a_name_that_leaves_much_over_is_doubted(offset_pool):
  right, levels = decided(offset_pool), usual_levels()
  most = smooth(8.0 * levels.material)
  left = lambda part: said(right, [most], [smooth(np.sqrt(part) * most.size)])
  decision = left(1.1 * levels.remains)
  assert decision.verdict == "partly_explained"
  assert decision.claims[0].probability == pytest.approx(levels.doubt * right.claims[0].probability)
  assert left(0.9 * levels.remains).verdict == "explained"


def test_doubt_on_a_name_is_no_gain_of_the_names_like_it(offset_pool):
  """What the claim loses is nobody's: the mixture that cars are drawn from has it as the car without either."""
  right, most = decided(offset_pool), smooth(8.0 * usual_levels().material)
  like = dataclasses.replace(right.claims[0], probability=0.5, shared=0.9, indistinguishable_from=("side_force",))
  doubted = said(dataclasses.replace(right, claims=(like,)), [most], [most]).claims[0]
  assert not doubted.certain
  assert doubted.probability / doubted.shared == pytest.approx(0.5 / 0.9)


def test_smooth_structure_is_what_is_large_and_not_by_chance():
  levels = usual_levels()
  for size, t, notable in ((1.1, 4.0, True), (0.9, 4.0, False), (9.0, 1.0, False)):
    item = smooth(size * levels.material, t)
    assert (above_level([item], levels) == (item,)) == notable
  assert strength(smooth(0.1, 4.0, blocks=3), levels) == 0.0  # four standard errors of three blocks are chance


@pytest.mark.parametrize(("ratio", "notable"), [(0.9, False), (1.1, True)])
def test_structure_is_none_where_a_channel_errs_by_what_its_sensor_makes_anyway(ratio, notable):
  levels = usual_levels()
  item, gyro = smooth(9.0 * levels.material), Leftover("yaw_rate", "error", (), 0.1, count=900, size=0.5)
  whole = dataclasses.replace(gyro, channel="accel_y", nats=ratio * levels.good)
  assert (above_level([gyro, item, whole], levels) == (item,)) == notable


@pytest.mark.parametrize("count", [5, 25, 200])
def test_a_line_is_one_that_noise_would_not_make(count):
  """Mean excess of unit exponentials: the level is passed as often as it says, at a chance that can be counted."""
  levels, random = dataclasses.replace(usual_levels(), rhythm=0.01), np.random.default_rng(count)
  means = random.exponential(size=(20_000, count)).mean(axis=1) - 1.0
  line = lambda nats: Leftover("accel_y", "rhythm", (), nats, count=count, size=levels.material)
  assert np.mean([strength(line(x), levels) >= 1.0 for x in means]) == pytest.approx(0.01, abs=0.002)
  assert strength(line(9.0), usual_levels()) > 1.0
  assert strength(dataclasses.replace(line(9.0), count=0), levels) == 0.0


def test_an_error_that_follows_nothing_is_left_where_it_is_many_times_the_noise(offset_pool):
  """Of channels measured directly; a displacement hangs on one slide of the car, and a quiet sensor sees trifles."""
  levels, right = usual_levels(), decided(offset_pool)
  fit = lambda before, after, noise: ChannelFit(before, after, 0.0, noise, (0.0, 0.0), "", 900)
  fits = {"yaw_rate": fit(2.0, 1.5, 0.1), "accel_y": fit(1e-3, 1e-3, 1e-5), "pose_turn": fit(9.0, 9.0, 0.1)}
  before, after = errors_left(fits, offset_pool)
  assert [i.channel for i in after] == ["yaw_rate", "accel_y"] and after[0].nats == pytest.approx(15.0)
  assert above_level(after, levels) == (after[0],)
  assert said(right, before, after).verdict == "partly_explained"
  mended = errors_left({"yaw_rate": fit(2.0, 0.5, 0.1)}, offset_pool)
  assert said(right, *mended).verdict == "explained"
  known = smooth(1.1 * levels.material)
  assert above_level([*after, known], levels) == (known, after[0])
  gone = smooth(30.0 * levels.material)  # however much structure a name took away, three quarters of an error are much
  assert said(right, [*before, gone], after).verdict == "partly_explained"


def test_two_effects_are_claimed_together(pair_pool):
  decision = decided(pair_pool)
  assert {c.mechanism for c in decision.claims} == {"steering_offset", "side_force"}
  assert decision.mechanisms == ("side_force", "steering_offset")


def test_what_is_likely_alone_but_too_small_to_matter_is_possible_at_most(offset_pool):
  much = dataclasses.replace(EASY, gain=0.99)
  decision = decided(offset_pool, much)
  assert decision.claims == () and "steering_offset" in decision.possible
  assert "steering_offset" not in decided(offset_pool, EASY).possible


def test_two_names_that_imitate_one_are_no_larger_set(pair_pool):
  """A pair that does not hold the name claimed alone must be likely against that name, too."""
  trim, other = frozenset(["steering_offset"]), frozenset(["gyro_scale", "side_force"])
  pair = pair_pool.models[frozenset(["side_force", "steering_offset"])]
  alone = dataclasses.replace(pair_pool.models[trim], residual=pair.residual)
  imitating = renamed(pair_pool, pair, "steering_offset", "gyro_scale")
  force = pair_pool.models[frozenset(["side_force"])]
  scale = renamed(pair_pool, force, "side_force", "gyro_scale")
  models = {frozenset(): pair_pool.base, trim: alone, other: imitating}
  models |= {frozenset(["side_force"]): force, frozenset(["gyro_scale"]): scale}
  decision = decided(dataclasses.replace(pair_pool, models=models))
  assert [c.mechanism for c in decision.claims] == ["steering_offset"]


def test_what_a_mechanism_too_small_to_matter_explains_is_no_riddle(offset_pool):
  """Its structure stands out, and is gone once the effect, there but not claimed, is taken into account."""
  levels = usual_levels()
  evidence = gather(offset_pool).with_left((), what_is_left(offset_pool, ()))
  riddle = dataclasses.replace(decided(offset_pool), claims=(), possible=(), mechanisms=())
  assert judged(riddle, evidence, levels) == () and conclude(riddle, evidence, levels).verdict == "unexplained"
  small = dataclasses.replace(riddle, possible=("steering_offset",))
  assert judged(small, evidence, levels) == ("steering_offset",)
  assert conclude(small, evidence, levels) == small  # what its model leaves was not looked at
  whole = evidence.with_left(("steering_offset",), what_is_left(offset_pool, ["steering_offset"]))
  assert conclude(small, whole, levels).verdict == small.verdict == "explained"


def test_a_small_effect_in_other_channels_is_named_beside_a_strong_one():
  """A drag that shows in the speed alone, many times stronger than what pushes sideways."""
  truth = {"quadratic_drag": 1.5, "side_force": 0.5}
  pool = rig.session(truth, seed=3)
  both = frozenset(truth)
  pool.models[both] = rig.solved(pool.problem, tuple(sorted(both)))
  alone = pool.models[frozenset(["quadratic_drag"])]
  assert alone.cost - pool.models[both].cost < 0.2 * (pool.base.cost - alone.cost)
  assert {c.mechanism for c in decided(pool).claims} == both


@pytest.fixture(scope="module")
def biased_pool():
  """A gyro that reads 0.2 rad/s too much, as part of the base, where sensors' own errors are."""
  twin = rig.LinearTwin(("gyro_bias",))
  problem = rig.problem_of(twin, rig.measure(twin, rig.drive(), {"gyro_bias": 0.2}))
  base = rig.solved(problem, ("gyro_bias",))
  base.mechanisms = ()
  return Pool(problem, rig.BASE, {frozenset(): base}, {}, dict(rig.NOISE))


def test_a_bias_is_claimed_beyond_what_every_sensor_has(biased_pool, monkeypatch):
  """Claimed if such gyros are known to within 0.02 rad/s, not if to within 0.3."""

  def claimed(pool):
    evidence = gather(pool)
    return [c.mechanism for c in sensor_claims(evidence.base, evidence, usual_levels())]

  for usual, claims in ((0.02, ["gyro_bias"]), (0.3, [])):
    kind = type(biased_pool.problem.mechanism("gyro_bias"))
    monkeypatch.setattr(kind, "sensor_errors", {"gyro_bias": SensorError(usual)})
    assert claimed(biased_pool) == claims


def test_a_bias_is_weighed_against_the_nearest_usual_one_and_not_against_none(biased_pool, monkeypatch):
  """What explains the rest of it is a quadratic's: ((b - r) / b)^2 of what explains all, r what is usual."""

  def drop(usual: float) -> float:
    kind = type(biased_pool.problem.mechanism("gyro_bias"))
    monkeypatch.setattr(kind, "sensor_errors", {"gyro_bias": SensorError(usual)})
    (row,) = gather(biased_pool).base.sensors
    return row.held_out.drop

  reach = usual_levels().usual_reach(1)
  assert reach == pytest.approx(2.326, abs=1e-3)
  whole = drop(1e-9)
  assert drop(0.04) == pytest.approx(whole * (1.0 - 0.04 * reach / 0.2) ** 2, rel=0.02)
  assert drop(1.0) == pytest.approx(whole, rel=1e-6)  # usual: what every model has of it


def test_a_sensors_age_is_claimed_where_it_departs_as_a_figure_does(biased_pool):
  """Not by its bias' usual size: what every sensor has and the twin's own form say how far an age is unusual."""
  evidence = gather(biased_pool)
  for value, claims in ((0.03, ["gyro_bias"]), (0.003, [])):
    age = Measured("gyro_bias", 0.0, 0.003, value, 0.01, "s", usual=True)
    model = dataclasses.replace(evidence.base, measured=(age,))
    assert [c.mechanism for c in sensor_claims(model, evidence, usual_levels())] == claims


@pytest.mark.parametrize("axes", [1, 2, 4])
def test_where_a_chance_is_stated_as_many_sensors_are_unusual(axes):
  levels, test = dataclasses.replace(usual_levels(), unusual=0.05), Comparison(0.0, 0.0, 0.0, (), 0.0)
  draws = np.random.default_rng(0).standard_normal((4000, axes))
  named = (Named("", test, False, (), (), deviations=tuple(row)) for row in draws.tolist())
  assert np.mean([beyond_usual(n, levels) for n in named]) == pytest.approx(0.05, abs=0.015)


@pytest.mark.parametrize(
  ("name", "size", "expected"),
  [
    ("coast_freewheel", 1.0, False),  # all of the motor's braking is gone
    ("drive_chopped", 1.0, False),
    ("drive_limit_braking", 20.0, False),
    ("drive_limit", 4.0, True),  # some current drives any car that moves
    ("drive_asymmetry", -0.6, True),
  ],
)
def test_a_bound_where_the_physics_ends_is_a_size_like_any_other(name, size, expected):
  mechanism = next(m for m in catalogue().values() if name in {p.name for p in m.parameters})
  pool = SimpleNamespace(problem=SimpleNamespace(mechanism={mechanism.name: mechanism}.__getitem__))
  model = SimpleNamespace(free=[name], estimate=lambda _: (size, 0.05))
  assert stretched(pool, model, mechanism.name) == expected


def test_an_amplitude_at_its_bound_is_no_claim(pair_pool):
  """What goes as far as it may makes up for something else more often than not; at its null it is only absent."""
  pair = pair_pool.models[frozenset(["side_force", "steering_offset"])]
  index = pair.free.index("side_force")
  limit = pair_pool.problem.mechanism("side_force").parameters[0].upper
  assert not stretched(pair_pool, pair, "side_force")
  pair = dataclasses.replace(pair, values=pair.values.copy())
  pair.values[index] = limit
  assert stretched(pair_pool, pair, "side_force") and not stretched(pair_pool, pair, "steering_offset")
  near = dataclasses.replace(pair, values=pair.values.copy())
  for away, expected in ((0.9, True), (1.1, False)):  # standard deviations
    near.values[index] = limit - away * pair.std[index]
    assert stretched(pair_pool, near, "side_force") == expected
  pool = dataclasses.replace(pair_pool, models=pair_pool.models | {frozenset(pair.mechanisms): pair})
  found = claimed_of(pool, pair, "side_force")
  assert found.probability == found.shared == 0.0
  assert {c.mechanism for c in decided(pair_pool).claims} == {"steering_offset", "side_force"}
  assert len(decided(pool).claims) == 1


def test_a_first_name_at_its_bound_does_not_keep_a_right_one_from_joining(pair_pool):
  limit = pair_pool.problem.mechanism("steering_offset").parameters[0].upper
  models = dict(pair_pool.models)
  for key in (frozenset(["steering_offset"]), frozenset(["side_force", "steering_offset"])):
    models[key] = dataclasses.replace(models[key], values=models[key].values.copy())
    models[key].values[models[key].free.index("steering_offset")] = limit
  assert min(pair_pool.of_size(1), key=lambda m: m.cost).mechanisms == ("steering_offset",)
  assert [c.mechanism for c in decided(dataclasses.replace(pair_pool, models=models), EASY).claims] == ["side_force"]
