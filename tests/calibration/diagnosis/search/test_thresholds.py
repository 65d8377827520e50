"""What counts as significant: held-out evidence, and no more of it than the fit gained."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.score import Comparison, compare
from calibration.diagnosis.search.thresholds import Thresholds, significant, strength

LIMITS = Thresholds()


def comparison(gain, t, **other):
  return Comparison(gain=gain, t=t, share_positive=0.7, blocks=np.full(40, gain / 40), before=1e4, **other)


def test_a_gain_needs_nats_a_t_and_most_of_the_blocks():
  enough = comparison(LIMITS.nats, LIMITS.t)
  assert strength(enough, LIMITS) == pytest.approx(1.0) and significant(enough, LIMITS)
  assert not significant(comparison(0.9 * LIMITS.nats, LIMITS.t), LIMITS)
  assert not significant(comparison(LIMITS.nats, 0.9 * LIMITS.t), LIMITS)
  assert not significant(dataclasses.replace(enough, share_positive=0.9 * LIMITS.share), LIMITS)


def test_every_parameter_but_the_first_needs_nats_of_its_own():
  t = np.sqrt(LIMITS.t**2 + 2 * LIMITS.sought)
  assert strength(comparison(LIMITS.nats, t, added=4), LIMITS) < 1.0
  assert strength(comparison(LIMITS.nats + 3 * LIMITS.shape, t, added=4), LIMITS) == pytest.approx(1.0)


def test_what_was_sought_far_and_wide_needs_a_larger_t():
  """A slippery place that a session without effects was fitted with (null_10 of seed 6626070): no claim."""
  lucky = comparison(53.7, 2.66, added=5)
  assert significant(dataclasses.replace(lucky, added=2), LIMITS)
  assert not significant(lucky, LIMITS) and not significant(dataclasses.replace(lucky, gain=500.0), LIMITS)
  assert significant(dataclasses.replace(lucky, t=3.6), LIMITS)


def test_what_acts_in_one_place_needs_no_more_where_it_explains_much():
  """A slippery place that is there (single_34 of seed 4669201), and one that explains half as much."""
  local = comparison(51.7, 2.23, added=5)
  assert local.relative < 0.5 * LIMITS.clear and not significant(local, LIMITS)
  large = dataclasses.replace(local, before=51.7 / 0.09)
  assert significant(large, LIMITS) and not significant(large, LIMITS.beside_others())
  assert not significant(dataclasses.replace(large, t=0.9 * LIMITS.t_many), LIMITS)
  assert not significant(dataclasses.replace(large, before=51.7 / 0.05), LIMITS)


def test_held_out_evidence_counts_as_far_as_the_fit_bears_it_out():
  """A change of grip that a session without effects was fitted with gained twice as much held out: no claim."""
  lucky = comparison(42.2, 3.4, added=4, drop=20.2)
  assert not significant(lucky, LIMITS)
  assert significant(dataclasses.replace(lucky, drop=42.2), LIMITS)


def test_the_drop_is_what_the_fit_gained_with_its_priors(offset_pool):
  model, base = offset_pool.models[frozenset(["steering_offset"])], offset_pool.base
  found = compare(model, base, offset_pool.problem.observations)
  assert found.drop == pytest.approx(base.cost - model.cost)
  assert compare(base, model, offset_pool.problem.observations).drop == pytest.approx(-found.drop)
