"""A twin that predicts worse than a simpler one is not written, and the report says so."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis import shipping
from calibration.diagnosis.curves import after_diagnosis
from calibration.diagnosis.curves.after_diagnosis import judged_with_curves
from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.report import page
from calibration.diagnosis.shipping import Judged, Written, judge, kind, objections, shipped, warning, worse_on
from tests.calibration.diagnosis.diagnosis_results import diagnosis_of

BLOCKS, SAMPLES = 40, 25


def fits(**changes):
  return {
    name: ChannelFit(1.0, after, 0.1, 0.1, (after - 1.5, after - 0.5), "rad/s", 100) for name, after in changes.items()
  }


@pytest.fixture
def outcome(offset_pool):
  diagnosis = diagnosis_of(offset_pool, ("steering_offset",))
  cut = SimpleNamespace(command_shift=-1)
  return SimpleNamespace(diagnosis=diagnosis, twin="car", before=np.zeros(2), after=np.ones(2), cut=cut)


@pytest.mark.parametrize(
  ("validate", "holdout", "worse"),
  [
    (fits(yaw_rate=0.5, accel_y=1.4), fits(yaw_rate=0.9), ()),
    (fits(yaw_rate=0.9, accel_y=1.2), fits(yaw_rate=0.9), ("validation",)),
    (fits(yaw_rate=0.9), fits(yaw_rate=1.01), ("held-out",)),
    (fits(yaw_rate=1.5), fits(accel_y=1.5), ("validation", "held-out")),
    ({}, {}, ()),
  ],
)
def test_the_recalibrated_twin_is_written_where_the_repaired_one_predicts_worse(outcome, validate, holdout, worse):
  outcome.diagnosis = dataclasses.replace(outcome.diagnosis, validate=validate, holdout=holdout)
  written = shipped(outcome)
  assert worse_on(outcome.diagnosis) == worse
  assert written.theta is (outcome.before if worse else outcome.after) and written.command_shift == -1
  assert kind(outcome.diagnosis) == ("recalibrated" if worse else "repaired")
  assert all(name in warning(outcome.diagnosis) and name in written.note for name in worse)
  assert bool(warning(outcome.diagnosis)) is bool(worse)


def test_a_twin_to_which_nothing_was_added_is_not_called_repaired(outcome, offset_pool):
  outcome.diagnosis = diagnosis_of(offset_pool, ())
  assert kind(outcome.diagnosis) == "recalibrated" and shipped(outcome).note.startswith("recalibrated on ")


def test_a_twin_that_surely_errs_more_in_one_channel_is_not_written(outcome):
  """However much it gains in the others; what is within 2 %, or may be chance, does not count."""
  gains, sure = (
    fits(yaw_rate=0.2),
    lambda after: {"accel_y": ChannelFit(1.0, after, 0.1, 0.1, (0.005, 0.2), "m/s^2", 100)},
  )
  for after, said in ((1.1, "held-out recordings lateral acceleration errs by 10 % more"), (1.01, "")):
    outcome.diagnosis = dataclasses.replace(outcome.diagnosis, validate=gains, holdout={**gains, **sure(after)})
    assert worse_on(outcome.diagnosis) == () and (
      said in warning(outcome.diagnosis) if said else not warning(outcome.diagnosis)
    )
    assert shipped(outcome).theta is (outcome.before if said else outcome.after)


def test_a_twin_that_does_not_reach_what_was_logged_is_not_written(outcome):
  replay = outcome.diagnosis.replay
  rows = replay.observations.select("motor_speed")
  logged = replay.observations.measured
  gains = {"validate": fits(yaw_rate=0.2), "holdout": {}}
  for share, short in ((0.85, True), (0.95, False)):
    after = np.where(rows, (share - 1.0) * logged, replay.after)
    slow = dataclasses.replace(replay, after=after)
    outcome.diagnosis = dataclasses.replace(outcome.diagnosis, replay=slow, **gains)
    assert any("the fast end of motor speed" in clause for clause in objections(outcome.diagnosis)) is short
  # nothing simpler would do better
  both = dataclasses.replace(
    replay, before=np.where(rows, -0.3 * logged, 0.0), after=np.where(rows, -0.2 * logged, 0.0)
  )
  outcome.diagnosis = dataclasses.replace(outcome.diagnosis, replay=both)
  assert objections(outcome.diagnosis) == ()


def test_file_document_and_page_tell_the_same(outcome, tmp_path, monkeypatch):
  saved = {}
  monkeypatch.setattr(
    page, "save_twin", lambda path, twin, theta, note, shift: saved.update({path.name: (theta, note)})
  )
  outcome.diagnosis = dataclasses.replace(outcome.diagnosis, validate=fits(yaw_rate=1.2))
  text = page.write_diagnosis(outcome, tmp_path, page.NOTHING_SHOWN).read_text(encoding="utf-8")
  assert saved["twin.toml"][0] is outcome.before and "validation" in saved["twin.toml"][1]
  assert json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))["shipped"] == "recalibrated"
  assert "<dt>Written as twin.toml</dt>" in text and "errors on validation recordings are larger" in text


@pytest.mark.parametrize(
  ("ratios", "against"),
  [
    ({"motor_speed": 0.5, "yaw_rate": 1.02, "accel_y": 0.9}, ()),  # a small loss in one, a gain in all
    ({"motor_speed": 4.5, "yaw_rate": 0.4, "accel_y": 0.4}, ("motor_speed",)),  # all gain on average, one is lost
    ({"motor_speed": 1.1, "yaw_rate": 1.2, "accel_y": 0.9}, ("motor_speed", "yaw_rate")),
    ({"motor_speed": 0.9, "yaw_rate": 0.9, "accel_y": 0.9}, ()),
  ],
)
def test_curves_must_not_lose_in_one_channel_more_than_all_gain(monkeypatch, ratios, against):
  channels = np.repeat(list(ratios), BLOCKS * SAMPLES)
  block = np.tile(np.repeat(np.arange(BLOCKS), SAMPLES), len(ratios))
  observations = SimpleNamespace(
    present=tuple(ratios), block=block, measured=0.0 * block, select=lambda name: channels == name
  )
  error = np.random.default_rng(3).normal(size=len(channels))
  scaled = error * np.array([ratios[name] for name in channels])
  monkeypatch.setattr(
    shipping, "_driven", lambda written, recordings: (observations, error if written.note == "first" else scaled)
  )
  monkeypatch.setattr(shipping, "driving_noise", lambda recordings: {})
  monkeypatch.setattr(shipping, "residual_floor", lambda noise: {})
  first, second = (Written("car", np.zeros(1), note, 0) for note in ("first", "second"))
  assert judge(first, second, ["a recording"]).losing == against
  assert judge(first, second, []).losing == ()


def test_what_speaks_against_curves_is_said(outcome, monkeypatch):
  """Against the recalibrated twin what would against a repair; against the one written without them, what they lose."""
  sure = {"accel_y": ChannelFit(1.0, 1.1, 0.1, 0.1, (0.05, 0.2), "m/s^2", 100)}
  found = SimpleNamespace(shipped=Written("curved car", np.zeros(1), "", 0), unseen=Written("then", np.zeros(1), "", 0))
  dataset = SimpleNamespace(role=lambda role: [role])
  outcome.diagnosis = dataclasses.replace(outcome.diagnosis, validate=fits(yaw_rate=0.5), holdout=fits(yaw_rate=0.5))
  told = {"recalibrated": Judged(fits(yaw_rate=0.5)), "repaired": Judged(fits(yaw_rate=0.9))}
  stood = {"holdout": "curved car", "validate": "then"}  # what judged had not been fitted to yet

  def judges(first, second, recordings):
    assert second.twin == stood[recordings[0]]
    return told[first.note.split()[0]]

  monkeypatch.setattr(after_diagnosis, "judge", judges)
  roles, against = judged_with_curves(found, outcome, dataset)
  assert set(roles) == {"validate", "holdout"} and against == ()
  told["recalibrated"] = Judged(sure, ("it is too slow",))
  assert "lateral acceleration errs by 10 % more" in judged_with_curves(found, outcome, dataset)[1][0]
  assert "it is too slow" in judged_with_curves(found, outcome, dataset)[1]
  told.update(recalibrated=Judged(fits(yaw_rate=0.5)), repaired=Judged(fits(yaw_rate=1.2)))
  assert judged_with_curves(found, outcome, dataset)[1] == ("the errors of yaw rate grow",)
