"""Levels with sources, and the probability they make of a name's figures."""

import dataclasses
import math

import pytest

from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.evidence import Alternative, Measured, Model, Named
from calibration.diagnosis.decision.levels import FILE, read_levels, usual_levels
from calibration.diagnosis.decision.weighing import counts, matters, reconciles
from calibration.diagnosis.score import compare
from calibration.diagnosis.search.gather import Weighing, gather

LEVELS = usual_levels()


def test_a_probability_is_logistic_in_what_levels_say():
  logit = LEVELS.constant + 2.0 * LEVELS.t + math.log1p(30.0 / LEVELS.near) * LEVELS.margin
  assert LEVELS.probability(2.0, 30.0) == pytest.approx(1.0 / (1.0 + math.exp(-logit)))


@pytest.mark.parametrize("more", [(3.0, 30.0), (2.0, 40.0)])
def test_more_evidence_makes_a_name_likelier(more):
  assert LEVELS.probability(*more) > LEVELS.probability(2.0, 30.0)


def test_beyond_their_limits_figures_tell_no_more():
  most = LEVELS.most_t
  assert LEVELS.figures(9.0 * most, 1.0) == LEVELS.figures(most, 1.0)
  assert LEVELS.figures(-9.0 * most, 1.0) == LEVELS.figures(-most, 1.0)
  assert LEVELS.figures(0.0, -5.0)[1] == -LEVELS.figures(0.0, 5.0)[1]


@pytest.mark.parametrize(
  "change, said",
  [
    (("[near]", "[far]"), "levels must be"),
    (('unit = "odds"', ""), "'bursts' has no unit"),
    (('source = "one standard error"', 'source = ""'), "'equivalent' has no source"),
  ],
)
def test_a_level_that_is_missing_or_has_no_source_is_refused(tmp_path, change, said):
  file = tmp_path / "levels.toml"
  file.write_text(FILE.read_text().replace(*change))
  with pytest.raises(ValueError, match=said):
    read_levels(file)


def test_a_name_is_weighed_against_the_model_without_it_and_its_rivals(pair_pool):
  both = pair_pool.models[frozenset(["side_force", "steering_offset"])]
  weighed = Weighing(pair_pool).named
  found, without = weighed(both, "side_force"), pair_pool.models[frozenset(["steering_offset"])]
  assert found.held_out.drop == pytest.approx(without.cost - both.cost)
  assert found.held_out.t == compare(both, without, pair_pool.problem.observations).t
  single = pair_pool.models[frozenset(["steering_offset"])]
  alone = weighed(single, "steering_offset")
  best = max(a.nats for a in alone.alternatives)
  same = dataclasses.replace(alone, alternatives=tuple(dataclasses.replace(a, beside=0.0) for a in alone.alternatives))
  assert alone.best_first[0].nats == best and same.margin() == pytest.approx(alone.held_out.drop - max(best, 0.0))
  assert alone.margin(leaving_out=tuple(a.name for a in alone.alternatives)) == pytest.approx(alone.held_out.drop)


def test_what_the_priors_gain_counts_as_held_out(offset_pool):
  """A mass that goes back to what was measured, by as many nats as the blocks' scatter: one more of t."""
  single, base = offset_pool.models[frozenset(["steering_offset"])], offset_pool.base
  found = compare(single, base, offset_pool.problem.observations)
  assert found.t == pytest.approx(found.gain / found.standard_error)
  more = dataclasses.replace(found, priors=found.priors + found.standard_error)
  assert more.t_with_priors == pytest.approx(found.t_with_priors + 1.0) and more.t == found.t


def test_a_name_matters_by_what_it_takes_off_errors(offset_pool):
  evidence, levels = gather(offset_pool), usual_levels()
  names = {n.name: n for m in evidence.of_size(1) for n in m.names}
  right, bystander = names["steering_offset"], names["quadratic_drag"]
  assert matters(right, levels) and not matters(bystander, levels)
  assert not matters(right, dataclasses.replace(levels, gain=0.99))
  all_left = math.prod(1.0 - e.share for e in right.errors)
  for added, said in ((0.9 / all_left - 1.0, True), (1.1 / all_left - 1.0, False)):  # to one channel's error
    worse = dataclasses.replace(right.errors[0], share=-added, t=-9.0)
    assert matters(dataclasses.replace(right, errors=(*right.errors, worse)), levels) == said


def test_a_name_counts_by_driving_beyond_chance_or_by_what_was_measured(offset_pool):
  evidence, levels = gather(offset_pool), usual_levels()
  names = {n.name: (n, m) for m in evidence.of_size(1) for n in m.names}
  (right, single), (bystander, other) = names["steering_offset"], names["quadratic_drag"]
  assert counts(right, single, evidence, levels)
  assert not counts(dataclasses.replace(right, scores=()), single, evidence, levels)
  assert not counts(bystander, other, evidence, levels)
  departs = dataclasses.replace(bystander, without=(AWAY,))
  assert counts(departs, dataclasses.replace(other, measured=(NEAR,)), evidence, levels)


NEAR = Measured("mass", 3.0, 0.03, 3.03, 3.0, "kg")
AWAY = dataclasses.replace(NEAR, value=4.5)
GYRO = Measured("imu_latency", 0.0, 0.005, 0.1, 0.01, "s", usual=True)


@pytest.mark.parametrize(
  "without, measured, said",
  [
    ((AWAY,), (NEAR,), True),
    ((NEAR,), (NEAR,), False),
    ((AWAY,), (AWAY,), False),
    ((AWAY, GYRO), (NEAR, GYRO), True),  # one of two
    ((AWAY,), (NEAR, GYRO), False),  # another instead
  ],
)
def test_a_name_reconciles_where_a_figure_departs_without_it_and_none_departs_instead(without, measured, said):
  test = Comparison(gain=0.0, t=0.0, share_positive=0.0, blocks=(), before=1.0)
  name = Named("payload", test, False, (), (), without=without)
  assert reconciles(name, Model(("payload",), 0.0, measured=measured), LEVELS) == said


@pytest.mark.parametrize(
  ("nats", "beside", "margin"),
  [
    (60.0, 0.0, 40.0),  # it explains the same, less well
    (160.0, 0.0, -60.0),  # the same, better
    (160.0, 100.0, 100.0),  # something else: the name brings all of its own beside it
    (160.0, 130.0, 100.0),  # something else that had hidden it
    (160.0, 50.0, 20.0),  # half of the name's
    (-9.0, 0.0, 100.0),
  ],
)
def test_what_explains_something_else_is_no_alternative(nats, beside, margin):
  test = Comparison(gain=0.0, t=0.0, share_positive=0.0, blocks=(), before=1.0, drop=100.0)
  rival = Alternative("differential_lock", nats, 1.0, False, 1.0, 0.0, beside)
  named = Named("command_delay", test, False, (), (), alternatives=(rival,))
  assert named.margin() == pytest.approx(margin) and named.margin(("differential_lock",)) == 100.0


def test_what_a_name_brings_beside_an_alternative_is_that_of_the_set_with_both(pair_pool):
  one, other = frozenset(["side_force"]), frozenset(["steering_offset"])
  row = Weighing(pair_pool).named(pair_pool.models[one], "side_force")
  (rival,) = (a for a in row.alternatives if a.name == "steering_offset")
  brought = pair_pool.models[other].cost - pair_pool.models[one | other].cost
  assert rival.beside == pytest.approx(brought) and brought > 10.0
