"""`curves` on a small session whose car turns less than it is told, the more the larger the angle.

And the same curves as a stage after a diagnosis.
"""

import dataclasses
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis.curves import after_diagnosis
from calibration.diagnosis.curves.after_diagnosis import judged_with_curves, wanted, write_with_curves
from calibration.diagnosis.curves.driven import error_of
from calibration.diagnosis.curves.report.page import sections
from calibration.diagnosis.curves.report.shapes import shapes
from calibration.diagnosis.curves.report.wording import verdict
from calibration.diagnosis.curves.study import KINDS, sentences
from calibration.diagnosis.holdout_errors import ratio
from calibration.diagnosis.pipeline import diagnose
from calibration.diagnosis.search.structure import Effort
from calibration.diagnosis.shipping import judge, shipped
from calibration.log_check.ready import ready
from qcar_twin.pages.page import show
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import load_twin
from scripts import curves
from tests.calibration.diagnosis.diagnosis_results import decision_of
from tests.scripts.tiny_session import write

pytestmark = pytest.mark.slow
CONCEALED = {"steering_nonlinearity": {"steering_nonlinearity": 0.3, "steering_nonlinearity_power": 1.0}}


@pytest.fixture(scope="module")
def done(tmp_path_factory):
  folder = tmp_path_factory.mktemp("characterised")
  write(folder / "data", CONCEALED)
  config = curves.Config(folder / "data", folder / "out", threads=2)
  return curves.main(config), folder / "out"


def test_the_curve_is_the_one_that_was_concealed(done):
  study, _ = done
  steering = next(o for o in study.outlines if o.curve == "steering_curve")
  reach = study.found.twin.parameters.named(study.found.theta)["steering_curve_reach"]
  assert reach == pytest.approx(0.2, rel=0.05)
  lost = -0.3 * reach / study.found.twin.vehicle.max_steering  # at the largest command, in shares of it
  assert steering.heights[-1] == pytest.approx(lost, abs=3.0 * steering.std[-1])


def test_what_judges_gets_better_and_every_reference_is_there(done):
  study, _ = done
  assert set(study.errors) <= set(KINDS) and {"base", "characterised", "black_box", "noise"} <= set(study.errors)
  assert study.gain > 0.03  # by validation; twenty seconds of driving do not carry to the harder turns of the hold-out


def test_what_is_shipped_is_fitted_to_what_judged_too(done):
  study, out = done
  twins = {"base": study.base, "curves": study.found.fitted, "characterised": study.told.fitted,
           "named": study.named.fitted}  # fmt: skip
  judging = ready(DataSet.load(out.parent / "data"))[0].role("validate")
  for kind, twin in twins.items():
    assert twin.problem.n_train == len(twin.problem.observations)
    # what it was told of before it had seen them is larger than what it leaves there now
    assert ratio(error_of(twin, judging), study.judged[kind]) < 1.0


def test_validation_errors_beside_a_diagnosis_are_of_a_twin_that_had_not_seen_them(done, outcome):
  """As those of the diagnosed twin are: the twin that is written was fitted to these recordings since."""
  study, (dataset, diagnosed) = done[0], outcome
  roles, _ = judged_with_curves(study, diagnosed, ready(dataset)[0])
  said = {name: fit.after for name, fit in roles["validate"].fits.items()}
  assert ratio(said, study.judged[study.best]) == pytest.approx(1.0, abs=0.005)


def test_names_stand_where_they_will_do_and_no_curve_where_none_departs(done):
  study, _ = done
  there = {o.curve: o for o in study.outlines if o.is_there}
  assert any("steering_nonlinearity" in form.mechanisms for form in there["steering_curve"].possible)
  named = [name for o in there.values() if o.named for name in o.named.mechanisms]
  assert set(named) | {a.mechanism for a in study.additions} == set(study.told.forms)
  assert set(study.told.curves) == {name for name, o in there.items() if o.named is None}
  assert not study.named.curves and len(study.told.fitted.fit.parameters) < len(study.found.fitted.fit.parameters)


def test_what_is_written_is_whole(done):
  study, out = done
  document = json.loads((out / "curves.json").read_text())
  assert [c["curve"] for c in document["curves"]] == [o.curve for o in study.outlines]
  twin, theta = load_twin(out / "twin.toml")
  kept = study.shipped
  twins = {"curves": study.found, "characterised": study.told, "named": study.named}
  judged = {kind: ratio(study.judged[kind], study.judged["base"]) for kind in ("base", *twins)}
  assert document["best"] == study.best == min(judged, key=judged.__getitem__)
  assert kept.twin.engine == "mujoco" and kept.twin.parameters.names == twins[study.best].twin.parameters.names
  values, expected = twin.parameters.named(theta), kept.twin.parameters.named(kept.theta)
  for name in twin.parameters.names:
    assert values[name] == pytest.approx(expected[name])


@pytest.fixture(scope="module")
def outcome(done):
  dataset = DataSet.load(done[1].parent / "data")
  effort = Effort(singles=1, pairs=0, triples=0, iterations=1)
  return dataset, diagnose(dataset, ("steering_offset",), effort=effort, threads=2)


def same_twin(file, twin, theta):
  """Whether a file holds a twin: its mechanisms that act, and their values."""
  loaded, values = load_twin(file)
  here, there = loaded.parameters.named(values), twin.parameters.named(theta)
  return all(name in there and there[name] == pytest.approx(here[name]) for name in here)


def test_the_curve_is_drawn_in_degrees_where_it_was_driven(done):
  study, _ = done
  (steering,) = [s for s in shapes(study.found, study.outlines) if s.part == "steering"]
  (view,) = steering.views
  told, limit = np.radians(view.x), study.found.twin.vehicle.max_steering
  concealed = np.degrees(-0.3 * told * np.abs(told) / limit)
  assert np.all(np.abs(view.departure - concealed) < 4.0 * view.std + 0.1)
  assert view.law == pytest.approx(view.x)
  size, std, where = steering.clearest
  assert size == pytest.approx(concealed[np.argmin(np.abs(view.x - where))], abs=4.0 * std) and abs(size) > 4.0 * std


def test_the_page_says_what_was_found(done):
  study, out = done
  drawn = shapes(study.found, study.outlines)
  text = (out / "report.html").read_text(encoding="utf-8")
  body = text[: text.index("plotly.js v")]
  assert body.index(verdict(study, drawn).replace("'", "&#39;")) < body.index("<h2>")
  titles = re.findall(r"<h2>(.*?)</h2>", body)
  assert titles == ["The maps", "Parameters fitted with the curves", "What it gains", "Warnings about the data set"]
  assert body.count('<figure class="chart">') == len(study.outlines) + 1
  for kind, values in study.errors.items():
    assert all(f">{show(value)}</td>" in body for value in values.values()), kind
  late = next(t for t in study.terms if t.name.endswith("_latency"))
  assert f"<td>{late.name}</td>" in body and f">{show(1e3 * late.value)}</td>" in body
  named = next(o.named for o in study.outlines if o.named)
  assert all(name in body for name in named.mechanisms)


def test_sessions_stand_in_a_table_with_their_trims_in_degrees(done):
  study, _ = done
  twin = SimpleNamespace(
    vehicle=study.found.twin.vehicle,
    parameters=study.found.twin.parameters,
    sessions=SimpleNamespace(names=("a", "b"), std={"steering_offset": 0.02}),
  )
  stub = SimpleNamespace(twin=twin, theta=study.found.theta, fitted=study.found.fitted)
  own = tuple(dataclasses.replace(study.terms[0], name=f"steering_offset@{s}", value=0.01, there=True) for s in "ab")
  (section,) = [
    s for s in sections(dataclasses.replace(study, found=stub, terms=own, outlines=()), ()) if s.title == "The sessions"
  ]
  assert [row[0] for row in section.tables[0].rows] == ["a", "b"]
  assert section.tables[0].rows[0][1] == pytest.approx(np.degrees(0.01)) and "[°]" in section.tables[0].columns[1]
  lacks = dataclasses.replace(
    study, found=stub, terms=own[:1], outlines=()
  )  # what one does as well without is not told
  (section,) = [s for s in sections(lacks, ()) if s.title == "The sessions"]
  assert section.tables[0].rows[1] == ["b", None, None, False]


@pytest.mark.parametrize("name", ["no_mismatch", "explained", "partly_explained", "unexplained"])
def test_curves_are_fitted_where_something_has_no_name_or_when_told(name):
  diagnosis = SimpleNamespace(decision=decision_of(name, ()))
  assert wanted("auto", diagnosis) is (name in ("partly_explained", "unexplained"))
  assert wanted("always", diagnosis) and not wanted("never", diagnosis)


@pytest.mark.parametrize("better", [True, False])
def test_the_twin_that_goes_on_is_the_better_by_validation(done, outcome, tmp_path, monkeypatch, better):
  study, (dataset, diagnosed) = done[0], outcome
  errors = {n: f.after * (0.9 if better else 1.1) for n, f in diagnosed.diagnosis.validate.items()}
  worse = {n: 2.0 * max(e, study.judged["base"][n]) for n, e in errors.items()}
  study = dataclasses.replace(study, judged=dict.fromkeys(study.judged, worse) | {"curves": errors})
  monkeypatch.setattr(after_diagnosis, "study", lambda *given: study)
  monkeypatch.setattr(after_diagnosis, "judged_with_curves", lambda *given: ({}, ()))
  page, said = write_with_curves(diagnosed, dataset, tmp_path, "always")
  whose = (study.found.twin, study.found.unshifted) if better else (diagnosed.twin, diagnosed.after)
  assert same_twin(tmp_path / "twin.toml", *whose)
  assert same_twin(tmp_path / "diagnosed.toml", diagnosed.twin, diagnosed.after)
  assert same_twin(tmp_path / "characterised.toml", study.found.twin, study.found.unshifted)
  document = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
  without = "repaired" if diagnosed.diagnosis.decision.mechanisms else "recalibrated"
  assert document["shipped"] == ("curves" if better else without)
  assert document["curves"]["validate"]["curves"] == pytest.approx(errors)
  findings = sentences(study, holdout=False)
  assert said[: len(findings)] == findings and said[-1].startswith("twin.toml is")
  assert not any(line.startswith("hold-out ") for line in said), "one table of hold-out errors"
  text = page.read_text(encoding="utf-8")
  fits = diagnosed.diagnosis.holdout
  before = {name: fit.before for name, fit in fits.items()}
  fell = 100.0 * ratio(study.errors["curves"], before)
  assert said[-1].replace("'", "&#39;") in text and f"{fell:.0f} % with curves" in text[: text.index("<h2>")]
  assert "<h2>Free curves: The maps</h2>" in text and ">after the diagnosis</th>" in text


def test_a_twin_that_steers_wrongly_loses_against_the_one_that_is_written_and_no_twin_against_itself(outcome):
  dataset, diagnosed = outcome
  judging = ready(dataset)[0].role("validate")
  good = shipped(diagnosed)
  theta = good.theta.copy()
  theta[good.twin.parameters.index("steering_offset")] += 0.15
  lost = judge(good, dataclasses.replace(good, theta=theta), judging).losing
  assert "yaw_rate" in lost and judge(good, good, judging).losing == ()


def test_a_study_that_fails_leaves_the_diagnosis(outcome, tmp_path, monkeypatch):
  dataset, diagnosed = outcome
  written = []

  def fails(*given):
    written.append(sorted(p.name for p in tmp_path.iterdir()))
    raise ValueError("too little driving")

  monkeypatch.setattr(after_diagnosis, "study", fails)
  page, (*_, said) = write_with_curves(diagnosed, dataset, tmp_path, "always")
  assert {"diagnosis.json", "report.html", "twin.toml"} <= set(written[0])
  text = page.read_text(encoding="utf-8")
  assert said.endswith("too little driving") and said in text[: text.index("<h2>")]
  assert same_twin(tmp_path / "twin.toml", diagnosed.twin, diagnosed.after)
  assert json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))["curves"] is None


def test_without_curves_something_nameless_is_pointed_out(outcome, tmp_path, monkeypatch):
  dataset, diagnosed = outcome
  monkeypatch.setattr(after_diagnosis, "study", lambda *given: pytest.fail("no curves were wanted"))
  for file in ("diagnosed.toml", "characterised.toml"):  # of an earlier run into the same folder
    (tmp_path / file).touch()
  for name, said in (("unexplained", 1), ("no_mismatch", 0)):
    decision = dataclasses.replace(diagnosed.diagnosis.decision, verdict=name)
    changed = dataclasses.replace(diagnosed, diagnosis=dataclasses.replace(diagnosed.diagnosis, decision=decision))
    lines = write_with_curves(changed, dataset, tmp_path, "never")[1]
    assert lines[0].startswith("errors on held-out recordings: recalibrated")
    assert sum("try --curves auto" in line for line in lines) == said
  assert not {"diagnosed.toml", "characterised.toml"} & {file.name for file in tmp_path.iterdir()}
