"""What a verdict looks at is of one model: its structure and its errors."""

import dataclasses

import pytest

from calibration.diagnosis import pipeline
from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.search.gather import gather
from tests.calibration.diagnosis.diagnosis_results import decided


def test_the_errors_of_a_name_too_small_to_claim_are_its_own(offset_pool, monkeypatch):
  """Where the model of such a name is looked at, what it gets wrong is not what the recalibrated twin gets wrong."""
  monkeypatch.setattr(pipeline, "fit_unknowns", lambda pool: {})
  monkeypatch.setattr(pipeline, "usual_levels", lambda: dataclasses.replace(usual_levels(), material=1e-3))
  fit = lambda before, after: {"yaw_rate": ChannelFit(before, after, 0.1, 0.1, (0.0, 0.0), "rad/s", 900)}
  errors = {(): fit(2.0, 2.0), ("steering_offset",): fit(2.0, 0.2)}
  right = decided(offset_pool)
  small = dataclasses.replace(right, claims=(), mechanisms=(), possible=("steering_offset",), verdict="no_mismatch")
  decision, _, evidence = pipeline._concluded(small, offset_pool, gather(offset_pool), errors.__getitem__)
  whole = lambda model: [i.nats for i in evidence.left(model) or () if i.family == "error"]
  assert whole(()) == pytest.approx([20.0]) and whole(("steering_offset",)) == pytest.approx([2.0])
  assert decision.verdict == "no_mismatch"


def test_held_out_recordings_are_opened_for_what_is_named_and_for_nothing_else(pair_pool):
  evidence, asked = gather(pair_pool), []

  def opening(mechanisms, ratio):
    asked.append(mechanisms)
    return dict.fromkeys(mechanisms, ratio)

  named, seen = pipeline._named(evidence, lambda m: opening(m, 0.5))
  assert asked == [named.mechanisms] == [("side_force", "steering_offset")] and seen.is_open(named.mechanisms)
  asked.clear()
  named, seen = pipeline._named(evidence, lambda m: opening(m, 2.0))
  assert len(asked) == len(set(asked)) and all(seen.is_open(m) for m in asked)
  assert named == pipeline.decide(seen)
