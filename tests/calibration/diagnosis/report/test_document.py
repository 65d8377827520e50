"""diagnosis.json holds to its schema to the letter, and nothing that breaks it is written."""

import dataclasses
import json

import numpy as np
import pytest

from calibration.diagnosis.decision.structure import Leftover
from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.report.document import (
  FILE,
  SCHEMA,
  document,
  faults,
  parameter_shifts,
  unknown_summary,
  unknown_variables,
  write_document,
)
from calibration.diagnosis.report.page import write_report
from calibration.diagnosis.report.wording import verdict_sentence
from qcar_twin.twin.mechanisms import catalogue
from tests.calibration.diagnosis.diagnosis_results import HELD, decision_of, diagnosis_of

# the keys of the published format, level by level; a change here is a change for everyone who reads the file
TOP = ("dataset verdict claims departures ranking where unknown parameter_shifts untestable concealment detectable"
       " next_experiment fit curves shipped seconds").split()  # fmt: skip


@pytest.fixture(scope="module")
def explained(offset_pool):
  return diagnosis_of(offset_pool, ("steering_offset",))


def test_a_diagnosis_makes_a_faultless_document(explained):
  found = document(explained)
  assert faults(found) == []
  assert list(found) == TOP == list(SCHEMA)
  assert list(found["claims"][0]) == [
    "mechanism",
    "probability",
    "evidence_nats",
    "parameters",
    "alternatives",
    "indistinguishable_from",
  ]
  assert list(found["where"]) == ["subsystem", "channels", "time", "region", "region_share"]
  assert list(found["unknown"]) == ["depends_on", "properties", "formula", "share"]
  keys = ["before", "after", "curves", "noise_floor", "driving_noise", "ci95"]
  assert list(found["fit"]["holdout"]["yaw_rate"]) == keys
  assert list(found["fit"]["validate"]["yaw_rate"]) == keys


def test_the_document_says_what_was_found(explained):
  found = document(explained)
  assert found["verdict"] == "explained"
  assert found["claims"][0]["mechanism"] == "steering_offset"
  assert found["claims"][0]["parameters"]["steering_offset"]["unit"] == "rad"
  assert found["where"]["subsystem"] == "steering"
  assert [r["mechanism"] for r in found["ranking"]][0] == "steering_offset"
  assert "gyro_scale" in found["untestable"]
  assert set(found["concealment"]) == set(explained.pool.signatures)
  assert all(0.0 <= v <= 1.0 + 1e-6 for v in found["concealment"].values())
  assert set(found["detectable"]) <= set(found["concealment"])
  assert found["detectable"]["quadratic_drag"]["size"] > 0.0 and found["detectable"]["gyro_scale"]["size"] is None
  assert found["next_experiment"] is None


def test_files_are_strict_json_and_can_be_read_back(explained, tmp_path):
  write_document(tmp_path / "out", explained)
  report = write_report(tmp_path / "out", explained)
  text = (tmp_path / "out" / FILE).read_text()
  assert "NaN" not in text and "Infinity" not in text
  assert faults(json.loads(text)) == []
  assert json.loads(text) == document(explained)
  assert report.name == "report.html" and report.exists()
  assert not [p for p in (tmp_path / "out").rglob("*") if p.name.startswith(".")]


def test_what_is_not_finite_becomes_null_where_that_is_allowed(explained):
  empty = ChannelFit(float("nan"), float("nan"), 0.1, 0.2, (float("nan"), float("inf")), "m", 0)
  found = document(dataclasses.replace(explained, holdout={"pose_left": empty}))
  assert found["fit"]["holdout"]["pose_left"] == {
    "before": None,
    "after": None,
    "curves": None,
    "noise_floor": 0.1,
    "driving_noise": 0.2,
    "ci95": [None, None],
  }
  assert faults(found) == []


def test_a_broken_document_is_not_written(explained, tmp_path):
  with pytest.raises(ValueError, match=r"diagnosis.json breaks its schema: .seconds"):
    write_document(tmp_path, dataclasses.replace(explained, seconds=float("nan")))
  assert not (tmp_path / FILE).exists()
  with pytest.raises(ValueError, match="maybe_so.* is none of no_mismatch"):
    bad = dataclasses.replace(explained.decision, verdict="maybe_so")
    write_document(tmp_path, dataclasses.replace(explained, decision=bad))


@pytest.mark.parametrize(
  ("change", "fault"),
  [
    (lambda d: d.pop("where"), ".where: missing"),
    (lambda d: d.update(extra=1), ".extra: not in the schema"),
    (lambda d: d.update(seconds=True), ".seconds: expected a finite number"),
    (lambda d: d["claims"][0].update(probability="high"), ".claims[0].probability: expected a finite number"),
    (
      lambda d: d["claims"][0]["indistinguishable_from"].append(3),
      ".claims[0].indistinguishable_from[0]: expected str",
    ),
    (lambda d: d.update(ranking={}), ".ranking: expected a list"),
    (lambda d: d.update(where=[]), ".where: expected an object"),
    (lambda d: d["unknown"].update(formula=2.0), ".unknown.formula: expected str"),
    (lambda d: d.update(next_experiment={"manoeuvre": "x"}), ".next_experiment.separates: missing"),
  ],
)
def test_faults_say_where(explained, change, fault):
  found = json.loads(json.dumps(document(explained)))
  change(found)
  assert any(line.startswith(fault) for line in faults(found)), faults(found)


def test_an_experiment_fits_the_schema(explained):
  wish = {
    "manoeuvre": "chirp_fast",
    "separates": ["steering_delay", "steering_lag"],
    "predicted_nats": np.float64(45.0),
  }
  assert faults(document(dataclasses.replace(explained, next_experiment=wish))) == []


def test_shifts_are_in_prior_standard_deviations(offset_pool):
  base = offset_pool.base
  shift = parameter_shifts(base)["mass"]
  assert shift["prior"] == 2.7
  assert shift["sigma"] == pytest.approx((shift["fitted"] - 2.7) / 0.02)
  assert set(parameter_shifts(base)) == set(base.free.names)


def test_the_unknown_speaks_only_where_the_verdict_rests_on_it():
  silent = unknown_summary(decision_of("explained", ("steering_offset",), unknown="unknown_force_x"))
  assert silent == {"depends_on": [], "properties": [], "formula": None, "share": 0.0}
  told = unknown_summary(decision_of("unexplained", (), unknown="unknown_force_x"))
  assert told["depends_on"] == ["speed", "steering", "voltage"] and told["share"] == 1.0
  partly = decision_of("partly_explained", ("steering_offset",), unknown="unknown_force_x")
  assert unknown_summary(partly)["share"] == pytest.approx(0.0)  # the claim gains as much as the nameless force
  assert HELD.gain > 0
  assert "accel_y" in unknown_variables("unknown_sensor_yaw_rate")


def test_what_is_left_over_tells_what_the_unknown_depends_on():
  left = (Leftover("accel_x", "heading", ("pose_yaw",), 3.0), Leftover("yaw_rate", "place", ("pose_x", "pose_y"), 2.0))
  decision = dataclasses.replace(decision_of("unexplained", (), unknown="unknown_force_x"), leftovers=left)
  told = unknown_summary(decision)
  assert told["depends_on"] == ["pose_yaw"]
  assert told["properties"] == ["turns with the heading", "tied to a place"]
  assert "most structure is in longitudinal acceleration: turns with the heading (heading)." in verdict_sentence(
    decision, {}
  )
  named = dataclasses.replace(decision_of("partly_explained", ("steering_offset",)), leftovers=left)
  assert "only part of the mismatch. Of the rest most structure is in" in verdict_sentence(named, catalogue())
