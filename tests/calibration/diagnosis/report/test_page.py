"""The report opens with the verdict, shows every section, and says nothing that its verdict does not rest on."""

import dataclasses
import re

import numpy as np
import pytest

from calibration.diagnosis.report import figures
from calibration.diagnosis.report.curves import Curve
from calibration.diagnosis.report.demonstration import Demonstration
from calibration.diagnosis.report.further import Further
from calibration.diagnosis.report.page import (
  channel_changes,
  effect_on_car,
  facts,
  report_sections,
  verdict,
  write_report,
)
from calibration.fitting.observations import CHANNELS
from qcar_twin.pages import Explorer, Section
from qcar_twin.pages.charts import unpacked
from tests.calibration.diagnosis.diagnosis_results import decision_of, diagnosis_of

SECTIONS = (
  "Where", "What", "The model", "Before and after", "What to drive next", "What could not be seen",
  "Parameters against their measurements", "Time and warnings",
)  # fmt: skip


@pytest.fixture(scope="module")
def explained(offset_pool):
  return diagnosis_of(offset_pool, ("steering_offset",))


@pytest.fixture(scope="module")
def nothing(clean_pool):
  return diagnosis_of(clean_pool, (), "no_mismatch", holdout={}, validate={}, stages={}, notes=("a gap in run_1",))


def test_the_page_stands_alone_and_opens_with_the_verdict(explained, tmp_path):
  text = write_report(tmp_path, explained).read_text()
  assert text.index("The wheels point to one side") < text.index("<h2>")
  for title in SECTIONS:
    assert f"<h2>{title.replace(chr(39), '&#39;')}</h2>" in text
  assert not re.search(r'(src|href)="(?!data:|#)', text[: text.index("plotly.js v")])
  assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_what_a_later_stage_adds_stands_behind_before_and_after(explained, tmp_path):
  added = Further("Curves found nothing.", [("curves", "none")], [Section("Free curves: the maps", "flat")])
  text = write_report(tmp_path, explained, further=added).read_text()
  assert text.index("The wheels point to one side") < text.index("Curves found nothing.") < text.index("<h2>")
  titles = re.findall(r"<h2>(.*?)</h2>", text)
  assert titles.index("Free curves: the maps") == titles.index("Before and after") + 1
  assert len(titles) == len(SECTIONS) + 1 and "<dt>curves</dt>" in text


def test_every_section_says_something(explained):
  for section in report_sections(explained):
    assert section.text.strip(), section.title
    for table in section.tables:
      assert table.rows, table.caption
  assert [s.title for s in report_sections(explained)] == list(SECTIONS)


def test_the_model_section_has_equation_amount_and_effect(explained):
  model = report_sections(explained)[2]
  assert "delta" in model.text and "On these recordings it moves" in model.text
  assert any("°" in str(cell) for row in model.tables[0].rows for cell in row)


def test_effect_on_the_car_is_the_difference_of_the_two_models(explained):
  pool = explained.pool
  model, base = pool.models[frozenset(["steering_offset"])], pool.base
  changes = channel_changes(explained, model, base)
  observations = pool.problem.observations
  rows = observations.select("yaw_rate")
  raw = pool.problem.raw(np.stack([model.theta, base.theta]))
  assert changes["yaw_rate"][0] == pytest.approx(np.sqrt(np.mean((raw[0] - raw[1])[rows] ** 2)), rel=1e-6)
  assert "yaw rate" in effect_on_car(explained, "steering_offset")
  assert effect_on_car(explained, "side_force") == ""


def test_no_mismatch_still_says_where_the_largest_residual_is(nothing, tmp_path):
  sections = report_sections(nothing)
  assert "Nothing is claimed" in sections[0].text and sections[0].tables[0].rows
  assert "No mechanism is claimed" in sections[1].text
  assert "nothing is added" in sections[2].text
  assert "No recordings were kept aside" in sections[3].text
  assert "a gap in run_1" in sections[7].text
  assert "no missing physics" in verdict(nothing)
  assert write_report(tmp_path, nothing).exists()


def test_an_unexplained_case_names_the_best_nameless_error(clean_pool):
  case = diagnosis_of(clean_pool, (), "unexplained", unknown="unknown_force_y")
  assert "an unknown force across the car" in verdict(case)
  what = report_sections(case)[1]
  assert "An unknown change of the steering angle explains most." in what.text
  assert [row[0] for row in what.tables[0].rows][0] == "an unknown change of the steering angle"


def test_a_page_on_a_named_cause_does_not_speak_of_nameless_ones(explained, nothing):
  for case in (explained, nothing):
    told = " ".join(s.text + " ".join(str(t.caption) for t in s.tables) for s in report_sections(case))
    assert case.location.degrees and "unknown" not in told and "nameless" not in told and "without a name" not in told


def test_facts_go_with_the_verdict(explained, nothing):
  told = dict(facts(explained))
  assert told["Verdict"] == "explained" and told["Probability that it is steering_offset"] == "0.97"
  assert told["Shows most in"].startswith("yaw rate (")
  assert facts(nothing) == [("Verdict", "nothing is missing")]


def test_untestable_and_concealed_effects_are_listed(explained):
  blind = report_sections(explained)[5]
  assert "gyro_scale" in blind.text and "does not mean that the car is free of them" in blind.text
  rows = {row[0]: row for row in blind.tables[0].rows}
  assert rows["gyro_scale"][3] == "no" and rows["steering_offset"][3] == "yes"
  assert rows["gyro_scale"][1] < 1.0 < rows["steering_offset"][1]


def test_the_next_drive_is_proposed_when_known(explained):
  assert report_sections(explained)[4].text.startswith("Nothing")
  wish = {"manoeuvre": "chirp_fast", "separates": ["steering_delay", "steering_lag"], "predicted_nats": 45.0}
  wanted = report_sections(dataclasses.replace(explained, next_experiment=wish))[4].text
  assert wanted == (
    "Drive chirp_fast. It should tell steering_delay from steering_lag: about 45 nats are expected of it."
  )


def test_the_explorer_shows_measured_before_and_after(explained):
  drawn = figures.explorer(explained.pool, explained.decision.model.residual, explained.location)
  assert isinstance(drawn, Explorer) and drawn.runs[0].name == explained.location.time[0].recording
  panel = next(p for p in drawn.runs[0].panels if p.title.startswith("yaw rate"))
  assert [ln.who for ln in panel.lines] == ["measured", "before", "twin"]
  measured, before, after = (ln.value for ln in panel.lines)
  assert np.mean((after - measured) ** 2) < np.mean((before - measured) ** 2)
  assert len(drawn.moments) == len(explained.location.time) and drawn.runs[0].shaded
  assert all(run.route is not None for run in drawn.runs) and "Click the map" in drawn.caption


def test_without_a_repair_or_a_pose_there_is_neither_after_nor_map(nothing):
  drawn = figures.explorer(nothing.pool, nothing.decision.model.residual, nothing.location)
  panel = next(p for p in drawn.runs[0].panels if p.title.startswith("yaw rate"))
  assert [ln.who for ln in panel.lines] == ["measured", "before"]
  assert drawn.runs[0].route is None and "Click the map" not in drawn.caption


def test_curves_stand_beside_the_forms_that_shape_them(explained):
  x = np.linspace(-1.0, 1.0, 5)
  points = {"nominal": (x, x), "before": (x, x), "twin": (x, x + 0.1)}
  curves = (Curve("Steering map", "command", "angle", ("steering",), "delta = u", points),
            Curve("Drive map", "V", "m/s", ("drive",), "torque = a u", points))  # fmt: skip
  model = report_sections(explained, Demonstration(curves=curves))[2]
  rows = [("Steering map", "delta = u", "steering_offset"), ("Drive map", "torque = a u", "nothing")]
  assert model.tables[-1].rows == rows
  chart = model.figures[0].data()
  assert [t["name"] for t in chart["traces"]] == 2 * ["nominal", "twin before", "twin repaired"]


def test_why_there_is_no_film_is_said(explained):
  shown = Demonstration(no_film="There is no film: no OpenGL.")
  assert "There is no film: no OpenGL." in report_sections(explained, shown)[0].text


def test_a_repair_that_does_not_help_is_not_praised(explained):
  worse = {n: dataclasses.replace(f, after=1.1 * f.before) for n, f in explained.holdout.items()}
  text = report_sections(dataclasses.replace(explained, holdout=worse))[3].text
  assert "does not lower the error" in text and "is gone" not in text
  assert "is gone" in report_sections(explained)[3].text


def test_cumulative_evidence_ends_at_its_sum(explained):
  trace = figures.evidence_over_time(explained.pool.problem.observations, explained.location).data()["traces"][0]
  assert unpacked(trace["y"])[-1] == pytest.approx(explained.location.evidence.sum(), rel=1e-6)
  assert np.all(np.diff(unpacked(trace["x"])) >= 0)


def test_evidence_bars_keep_the_order_of_the_ranking():
  names = ["steering_delay", "steering_lag", "side_force", "payload", "cogging"]
  ranking = tuple((name, 100.0 - 40.0 * i) for i, name in enumerate(names))
  trace = figures.ranked_evidence(decision_of("explained", ("steering_delay",), ranking=ranking)).data()["traces"][0]
  assert trace["y"] == names[:4]  # the last explains nothing
  assert trace["x"] == [100.0, 60.0, 20.0, 0.0]
  assert trace["marker"]["color"] == ["@twin", "@nominal", "@nominal", "@nominal"]


def test_errors_are_drawn_in_multiples_of_the_noise(explained):
  chart = figures.before_and_after(explained.holdout, "kept aside")
  assert chart is not None
  before, after = chart.data()["traces"]
  assert (before["y"][0], after["y"][0]) == pytest.approx((0.2 / 0.15, 0.16 / 0.15), rel=1e-4)
  assert after["error_y"]["array"][0] == pytest.approx((0.2 * 0.9 - 0.16) / 0.15, rel=1e-3)
  assert figures.before_and_after({}, "kept aside") is None
  assert set(explained.holdout) <= set(CHANNELS)
