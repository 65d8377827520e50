"""The commands of the main job, run as a user would with --quick on a tiny session whose truth is known."""

import contextlib
import importlib
import io
import json

import numpy as np
import pytest

from calibration.identification.drive_fit import NotIdentifiable
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.twin.file import load_twin
from qcar_twin.vehicle.vehicle import QCAR
from scripts import benchmark_calibration
from tests.scripts import tiny_session
from tests.scripts.tiny_session import NOISE, TRUTH


def run(name, **config):
  """What a command's main returns, and what it prints."""
  command, said = importlib.import_module(f"scripts.{name}"), io.StringIO()
  with contextlib.redirect_stdout(said):
    result = command.main(command.Config(**config))
  return result, said.getvalue()


def read(path):
  return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def work(tmp_path_factory):
  return tmp_path_factory.mktemp("work")


@pytest.fixture(scope="module")
def tiny(work):
  tiny_session.write(work / "data" / "tiny")
  return work / "data" / "tiny"


@pytest.fixture(scope="module")
def whole(work, tiny):
  """`qcar-twin run` on the tiny session: folder of its results and what it said."""
  report, said = run("run", dataset=tiny, out=work / "tiny", quick=True, threads=1, curves="never")
  assert report == work / "tiny" / "diagnosis" / "report.html"
  return work / "tiny", said


@pytest.mark.slow
def test_run_leaves_every_result_and_prints_the_verdicts(whole):
  folder, said = whole
  for part, document in (("calibration",) * 2, ("cross_validation",) * 2, ("diagnosis",) * 2):
    assert read(folder / part / f"{document}.json")["dataset"] == "tiny"
    assert (folder / part / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
  assert "calibrated twin errs by motor speed" in said and "In free runs the twin errs by" in said
  assert f"report: {folder / 'diagnosis' / 'report.html'}" in said
  assert read(folder / "diagnosis" / "diagnosis.json")["verdict"] in ("no_mismatch", "explained", "unexplained")


def test_run_calibrates_down_to_the_noise(whole):
  document = read(whole[0] / "calibration" / "calibration.json")
  for role in ("identify", "validate"):
    for channel, std in NOISE.items():
      error = document["errors"][role][channel]
      assert 0.9 * std < error["after"] < 1.3 * std < error["before"]
  for name, share in TRUTH.items():
    row, truth = document["parameters"][name], share * getattr(QCAR, name)
    assert row["value"] == pytest.approx(truth, abs=4 * row["std"])


def test_run_cross_validates_what_the_fit_did_not_see(whole):
  document = read(whole[0] / "cross_validation" / "cross_validation.json")
  assert set(document["recordings"]) == {"voltage_1.5", "steering_0.15", "weave_validate"}
  assert set(document["windows"]) == {"0.5 s", "2 s", "free run"}
  free = document["windows"]["free run"]
  assert free["twin"]["yaw_rate"]["rmse"] < 1.3 * NOISE["yaw_rate"] < free["bicycle"]["yaw_rate"]["rmse"]


def test_calibrate_goes_on_from_what_an_earlier_run_left(whole, tiny, capfd):
  folder = whole[0] / "calibration"
  before = read(folder / "calibration.json")
  calibration, said = run("calibrate", dataset=tiny, out=folder, against="recordings", quick=True, threads=1)
  assert "fit taken from an earlier run" in capfd.readouterr().err
  assert (
    calibration.document()["parameters"] == before["parameters"]
    and calibration.document()["errors"] == before["errors"]
  )
  assert f"report: {folder / 'report.html'}" in said


def test_calibrate_answers_the_identified_model_steps(work, tiny):
  calibration, said = run("calibrate", dataset=tiny, out=work / "tiny" / "identified", quick=True, threads=1)
  assert "answers the identified model's steps of the drive's command within" in said
  for role in ("identify", "validate"):
    assert calibration.step_percent("longitudinal", role) < 1.0 and calibration.step_percent("lateral", role) < 2.0
  twin, theta = load_twin(work / "tiny" / "identified" / "twin.toml", threads=1)
  assert twin.substeps == 5
  assert np.allclose(theta, calibration.theta, rtol=1e-9)


def test_calibrate_says_what_a_session_without_steps_lacks(work, tiny):
  data = DataSet.load(tiny)
  rest = [r for r in data.recordings if r.manoeuvre == "excitation"]
  write_dataset(work / "without", "without", data.vehicle, data.vehicle_std, rest)
  with pytest.raises(NotIdentifiable, match="steady speeds at two levels.*--against recordings"):
    run("calibrate", dataset=work / "without", out=work / "without_out", quick=True)
  assert not (work / "without_out" / "calibration.json").exists()


def test_cross_validate_takes_a_twin_and_opens_the_roles_asked_for(whole, work, tiny):
  twin = whole[0] / "calibration" / "twin.toml"
  validation, said = run(
    "cross_validate", dataset=tiny, out=work / "cv", twin=twin, roles=("holdout",), quick=True, threads=1
  )
  assert list(read(work / "cv" / "cross_validation.json")["recordings"]) == ["weave_holdout"]
  assert [r.name for r in validation.replays] == ["2 s"] and "In windows of 2 s the twin errs by" in said
  kept = read(whole[0] / "calibration" / "calibration.json")["parameters"]
  named = validation.twin.parameters.named(validation.theta)
  assert named["torque_per_volt"] == pytest.approx(kept["torque_per_volt"]["value"], rel=1e-9)


def test_cross_validate_names_the_roles_there_are(whole, work, tiny):
  twin = whole[0] / "calibration" / "twin.toml"
  with pytest.raises(ValueError, match="no recording with role judge, only holdout, identify, validate"):
    run("cross_validate", dataset=tiny, out=work / "none", twin=twin, roles=("judge",), quick=True, threads=1)


def test_diagnose_names_a_concealed_offset_of_the_steering(work):
  tiny_session.write(work / "data" / "offset", {"steering_offset": {"steering_offset": 0.04}})
  among = ("steering_gain_error", "steering_offset", "accel_bias", "gyro_bias", "encoder_latency")
  page, said = run(
    "diagnose",
    dataset=work / "data" / "offset",
    out=work / "offset",
    candidates=among,
    quick=True,
    threads=1,
    curves="never",
  )
  document = read(work / "offset" / "diagnosis.json")
  claim = document["claims"][0]
  assert claim["mechanism"] == "steering_offset" and document["ranking"][0]["mechanism"] == "steering_offset"
  assert "0.04" in json.dumps(claim) or "0.03" in json.dumps(claim)
  assert page.is_file() and f"report: {page}" in said
  repaired, theta = load_twin(work / "offset" / "twin.toml", threads=1)
  assert repaired.parameters.named(theta)["steering_offset"] == pytest.approx(0.04, abs=0.004)


def test_the_calibration_page_is_written_from_what_is_there(whole, work, tiny):
  assert (work / "tiny" / "identified" / "calibration.json").is_file()  # made by a test above
  text, _ = run(
    "benchmark_calibration", out=work / "page.md", work=work, datasets=(tiny,), steps=(tiny,), sessions=0, threads=1
  )
  assert (work / "page.md").read_text(encoding="utf-8") == text
  assert "| tiny | 0." in text and "| mean of those that move |  |" in text and "## tiny" in text
  assert "{" not in text and "nan" not in text


def test_the_calibration_page_says_where_it_is(work, tiny, monkeypatch, capsys):
  named = {"work": work / "fresh", "datasets": (tiny,), "steps": (tiny,), "sessions": 0, "threads": 1}
  said = []
  monkeypatch.setattr(benchmark_calibration, "match", lambda *given: given[-1]("identification"))
  monkeypatch.setattr(
    benchmark_calibration, "judge", lambda *given: [given[-1](s) for s in ("recalibration", "free run")]
  )
  monkeypatch.setattr(benchmark_calibration, "page", lambda *given: said.append(given) or "")
  benchmark_calibration.main(benchmark_calibration.Config(work / "fresh.md", **named))
  lines = [line.partition(" · about")[0] for line in capsys.readouterr().err.splitlines()]
  assert lines == [
    "stage 1 of 10 · tiny, steps: identification",
    "stage 5 of 10 · tiny, recordings: recalibration",
    "stage 9 of 10 · tiny, recordings: free run",
  ]
  assert len(said) == 1
