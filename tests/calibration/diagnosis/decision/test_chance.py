"""How far anything gets by chance: a stated share of data sets without an effect, however alike the mechanisms are."""

import dataclasses

import numpy as np
import pytest

from calibration.diagnosis.decision.chance import beyond_chance, consistency
from calibration.diagnosis.decision.comparison import Comparison
from calibration.diagnosis.decision.evidence import Evidence, Model, Named, Scanned
from calibration.diagnosis.decision.levels import usual_levels

ASKED = dataclasses.replace(usual_levels(), family=0.1)
BLOCKS, MECHANISMS = 40, 30


def named(scores, name="any"):
  return Named(name, Comparison(0.0, 0.0, 0.0, (), 0.0), False, (), (), scores=tuple(scores))


def evidence_of(scores):
  """Evidence of a data set with these scores, (M, B)."""
  rows = tuple(Scanned(str(m), 1.0, None, tuple(row)) for m, row in enumerate(scores.tolist()))
  return Evidence("", (Model((), 0.0),), rows)


def noise(random, alike=0.7):
  """Scores of mechanisms that look alike, with blocks of unlike noise, (M, B)."""
  shared, own = random.standard_normal((4, BLOCKS)), random.standard_normal((MECHANISMS, BLOCKS))
  loud = random.exponential(size=BLOCKS)
  return (alike * shared[np.arange(MECHANISMS) % 4] + (1.0 - alike) * own) * loud


@pytest.mark.parametrize("alike", [0.0, 0.7])
def test_as_many_data_sets_without_an_effect_pass_as_are_stated(alike):
  random, passed = np.random.default_rng(1), 0
  for _ in range(300):
    scores = noise(random, alike)
    best = max(scores, key=consistency)
    passed += beyond_chance(named(best), evidence_of(scores), ASKED)
  assert passed / 300 == pytest.approx(ASKED.family, abs=0.04)


def test_an_effect_in_all_blocks_passes_and_does_not_raise_the_level_for_others():
  scores = noise(np.random.default_rng(2))
  quiet = named(scores[1] + 3.0 * np.std(scores[1]))
  assert beyond_chance(quiet, evidence_of(scores), ASKED)
  loud = scores.copy()
  loud[0] += 1e3
  assert beyond_chance(quiet, evidence_of(loud), ASKED) and beyond_chance(named(loud[0]), evidence_of(loud), ASKED)


def test_what_one_block_shows_may_be_chance_however_strong():
  scores = noise(np.random.default_rng(3))
  once = np.zeros(BLOCKS)
  once[7] = 1e4
  assert not beyond_chance(named(once), evidence_of(scores), ASKED)


def test_nothing_passes_without_scores():
  evidence = evidence_of(noise(np.random.default_rng(4)))
  assert not beyond_chance(named(()), evidence, ASKED) and consistency(()) == 0.0
