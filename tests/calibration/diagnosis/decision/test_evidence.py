"""Evidence as plain numbers: what a decision needs survives a file, and nothing else changes what is decided."""

import dataclasses
import json
import math
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.diagnosis.decision.conclude import conclude
from calibration.diagnosis.decision.decide import decide
from calibration.diagnosis.decision.evidence import (
  FILE,
  HeldOutError,
  as_json,
  from_json,
  read_evidence,
  write_evidence,
)
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.search.gather import gather, what_is_left
from qcar_twin.untrusted import UnreadableFile

LEVELS = usual_levels()


@pytest.fixture(scope="module")
def evidence(pair_pool):
  """Of a car with two effects, with what the recalibrated twin and the model of both leave, and one hold-out error."""
  whole = gather(pair_pool, "linear car").with_left((), what_is_left(pair_pool, ()))
  both = ("side_force", "steering_offset")
  error = HeldOutError("holdout", "yaw_rate", 0.2, 0.16, (-0.3, -0.1), 0.15, "rad/s", 900)
  return dataclasses.replace(whole.with_left(both, what_is_left(pair_pool, both)), errors=(error,))


def test_evidence_is_read_back_as_it_was_written(evidence, tmp_path):
  file = write_evidence(tmp_path, evidence)
  assert file.name == FILE and read_evidence(file) == evidence
  assert from_json(json.loads(json.dumps(as_json(evidence)))) == evidence


def test_a_kept_case_is_decided_again_in_less_than_a_second(evidence, tmp_path):
  file = write_evidence(tmp_path, evidence)
  began = time.process_time()
  kept = read_evidence(file)
  again = conclude(decide(kept), kept, LEVELS)
  assert time.process_time() - began < 1.0
  assert again == conclude(decide(evidence), evidence, LEVELS) and again.verdict == "explained"
  assert {c.mechanism for c in again.claims} == {"side_force", "steering_offset"}


@given(st.randoms(use_true_random=False))
@settings(max_examples=20, deadline=None)
def test_the_order_of_models_names_and_mechanisms_is_irrelevant(evidence, random):
  mixed = lambda rows: tuple(random.sample(rows, len(rows)))
  names = lambda m: mixed([dataclasses.replace(n, alternatives=mixed(n.alternatives)) for n in m.names])
  models = [dataclasses.replace(m, names=names(m), against=mixed(m.against)) for m in evidence.models]
  other = dataclasses.replace(evidence, models=mixed(models), scanned=mixed(evidence.scanned))
  assert decide(other) == decide(evidence)


BOTH = ("side_force", "steering_offset")


@pytest.mark.parametrize(("ratio", "gain"), [(0.5, 1.0), (1.0, 0.0), (math.exp(0.5 * LEVELS.gain), -0.5), (3.0, -1.0)])
def test_a_name_is_worth_what_it_does_to_held_out_recordings(evidence, ratio, gain):
  sure = dataclasses.replace(LEVELS, constant=LEVELS.constant + 2.0)  # both are claimed, whatever is seen there
  opened = evidence.with_opened(BOTH, {"side_force": ratio})
  before, after = decide(evidence, sure), decide(opened, sure)
  assert opened.is_open(BOTH) and not evidence.is_open(BOTH)
  assert from_json(as_json(opened)) == opened
  odds = lambda d: {c.mechanism: c.probability / (1.0 - c.probability) for c in d.claims}
  assert odds(after)["steering_offset"] == odds(before)["steering_offset"]
  change = math.log(odds(after)["side_force"] / odds(before)["side_force"])
  assert change == pytest.approx(LEVELS.held * gain, abs=1e-3)


def test_a_name_falls_that_makes_held_out_recordings_worse_and_no_other_for_it(evidence):
  least = min(c.probability for c in decide(evidence).claims)
  doubtful = dataclasses.replace(LEVELS, constant=LEVELS.constant - 0.9 * math.log(least / (1.0 - least)))
  assert {c.mechanism for c in decide(evidence, doubtful).claims} == set(BOTH)
  opened = evidence.with_opened(BOTH, dict.fromkeys(BOTH, 2.0))
  fallen = decide(opened, doubtful)
  assert fallen.mechanisms != BOTH
  better = evidence.with_opened(BOTH, dict.fromkeys(BOTH, 0.5))
  assert decide(better, doubtful).mechanisms == decide(evidence, doubtful).mechanisms
  never = dataclasses.replace(doubtful, constant=-30.0)  # what was not likely is not made so by them
  assert not decide(better, never).claims


def test_who_is_told_of_a_name_that_is_not_likely_enough_is_told_what_it_makes_worse(evidence):
  strict = dataclasses.replace(LEVELS, constant=LEVELS.constant - 4.0)
  told = decide(evidence, strict).nearest
  name = told.removeprefix("The likeliest name is ").split(",")[0]
  assert name in BOTH and "held-out" not in told
  again = decide(evidence.with_opened((name,), {name: 1.004}), strict).nearest
  assert f"is {name}," in again and "the error on held-out recordings is 0.4 % larger" in again


@pytest.mark.parametrize("ratio", [0.0, math.inf, math.nan])
def test_a_twin_that_flies_apart_on_held_out_recordings_speaks_against_its_names(ratio):
  assert LEVELS.change(ratio) == -1.0


def changed(evidence, name, change):
  """Evidence with a name's figures changed wherever it was weighed."""
  one = lambda n: change(n) if n.name == name else n
  models = (dataclasses.replace(m, names=tuple(map(one, m.names))) for m in evidence.models)
  return dataclasses.replace(evidence, models=tuple(models))


def better(name, gain=0.0, priors=0.0, drop=0.0, taken=0.0):
  """A name with more held-out gain, more of it in the priors, a better fit, more taken off its errors."""
  test = name.held_out
  test = dataclasses.replace(test, gain=test.gain + gain, priors=test.priors + priors, drop=test.drop + drop)
  errors = tuple(
    dataclasses.replace(e, share=1.0 - (1.0 - e.share) * math.exp(-taken), t=e.t + taken) for e in name.errors
  )
  return dataclasses.replace(name, held_out=test, errors=errors)


@pytest.mark.parametrize("what", ["gain", "priors", "drop", "taken"])
@given(size=st.floats(0.01, 100.0))
@settings(max_examples=20, deadline=None)
def test_more_evidence_never_lowers_a_probability(evidence, what, size):
  probability = lambda e: {c.mechanism: c.probability for c in decide(e).claims}
  before = probability(evidence)
  after = probability(changed(evidence, "side_force", lambda n: better(n, **{what: size})))
  assert after["side_force"] >= before["side_force"] > 0.5


def test_a_file_that_also_has_what_nothing_depends_on_is_read_without_it(evidence):
  content = as_json(evidence)
  for model in content["models"]:
    for name in (*model["names"], *model["sensors"]):
      name["size"], name["held_out"]["added"] = 0.3, 1
      for item in (*name["estimates"], *name["alternatives"]):
        item |= {"size": 1.0, "typical": 0.1}
  assert from_json(content) == evidence


def test_a_file_that_is_no_evidence_is_refused(evidence, tmp_path):
  content = as_json(evidence)
  for change in ({"models": 3}, {"colour": "red"}, {"dataset": 7}, {"scanned": [{"name": "x"}]}):
    file = tmp_path / FILE
    file.write_text(json.dumps(content | change))
    with pytest.raises(UnreadableFile, match="diagnose the data set again"):
      read_evidence(file)


def test_half_the_square_of_the_scores_sum_is_the_gain_of_the_scan(offset_pool):
  found = {s.name: s for s in gather(offset_pool).scanned}["steering_offset"]
  assert 0.5 * np.sum(found.scores) ** 2 == pytest.approx(found.gain, rel=5e-3)
