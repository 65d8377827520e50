"""The report opens with the verdict, shows every section, and needs nothing from outside its file."""

import dataclasses
import re

import numpy as np
import pytest

from calibration.diagnosis.report import figures
from calibration.diagnosis.report.page import channel_changes, effect_on_car, report_sections, verdict, write_report
from calibration.fitting.observations import CHANNELS
from tests.calibration.diagnosis.diagnosis_results import decision_of, diagnosis_of

SECTIONS = (
  "Where", "What", "The model", "Before and after", "Parameters against their measurements",
  "What these recordings can't show", "Detectors", "Time and warnings",
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
  assert not re.search(r'(src|href)="(?!data:|#)', text)
  assert "nan" not in re.sub(r"base64,[^\"]*", "", text).lower().split()
  pictures = sorted(p.name for p in (tmp_path / "figures").iterdir())
  assert len(pictures) == text.count("<img ")
  assert pictures[0].startswith("01_measured_before_and_after")


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


def test_an_unexplained_case_names_the_best_nameless_error(clean_pool, tmp_path):
  case = diagnosis_of(clean_pool, (), "unexplained", unknown="unknown_force_y")
  assert "an unknown force across the car" in verdict(case)
  text = write_report(tmp_path, case).read_text()
  assert "The best nameless rival is an unknown force across the car" in text


def test_untestable_and_concealed_effects_are_listed(explained):
  blind = report_sections(explained)[5]
  assert "gyro_scale" in blind.text and "does not mean absent" in blind.text
  rows = {row[0]: row for row in blind.tables[0].rows}
  assert rows["gyro_scale"][3] == "no" and rows["steering_offset"][3] == "yes"
  assert rows["gyro_scale"][1] < 1.0 < rows["steering_offset"][1]


def test_the_next_drive_is_proposed_when_known(explained):
  wish = {"manoeuvre": "chirp_fast", "separates": ["steering_delay", "steering_lag"], "predicted_nats": 45.0}
  blind = report_sections(dataclasses.replace(explained, next_experiment=wish))[5]
  assert "Drive next: chirp_fast. It should tell steering_delay from steering_lag by about 45 nats" in blind.text


def test_traces_show_the_recordings_that_carry_the_evidence(explained):
  drawn = figures.traces(explained.pool, explained.decision.model.residual, explained.location)
  assert drawn is not None
  titles = [axis.get_title(loc="left") for axis in drawn.axes[::2]]
  assert titles and set(titles) <= set(explained.pool.problem.observations.names)
  lines = drawn.axes[0].get_lines()
  assert [line.get_label() for line in lines] == ["measured", "before", "repaired twin"]
  measured, before, after = (line.get_ydata() for line in lines)
  assert np.mean((after - measured) ** 2) < np.mean((before - measured) ** 2)
  errors = [line.get_ydata() for line in drawn.axes[1].get_lines()]
  assert np.allclose(errors[0], before - measured) and np.allclose(errors[1], after - measured)


def test_a_repair_that_does_not_help_is_not_praised(explained):
  worse = {n: dataclasses.replace(f, after=1.1 * f.before) for n, f in explained.holdout.items()}
  text = report_sections(dataclasses.replace(explained, holdout=worse))[3].text
  assert "does not lower the error" in text and "is gone" not in text
  assert "is gone" in report_sections(explained)[3].text


def test_cumulative_evidence_ends_at_its_sum(explained):
  axis = figures.evidence_over_time(explained.pool.problem.observations, explained.location).axes[0]
  line = axis.get_lines()[0]
  assert line.get_ydata()[-1] == pytest.approx(explained.location.evidence.sum())
  assert np.all(np.diff(line.get_xdata()) >= 0)


def test_the_map_needs_a_pose(explained, nothing):
  drawn = figures.drive_map(explained.pool.problem.observations, explained.location)
  assert drawn is not None
  rates = drawn.axes[0].collections[0].get_array()
  assert len(rates) > 20 and np.all(rates >= 0)
  assert figures.drive_map(nothing.pool.problem.observations, nothing.location) is None


def test_evidence_bars_keep_the_order_of_the_ranking():
  ranking = tuple((name, 100.0 - i) for i, name in enumerate(["steering_delay", "steering_lag", "side_force"]))
  drawn = figures.ranked_evidence(decision_of("explained", ("steering_delay",), ranking=ranking))
  axis = drawn.axes[0]
  assert [t.get_text() for t in axis.get_yticklabels()] == [n for n, _ in ranking]
  assert [p.get_width() for p in axis.patches] == [100.0, 99.0, 98.0]
  assert axis.yaxis_inverted()


def test_errors_are_drawn_in_multiples_of_the_noise(explained):
  axis = figures.before_and_after(explained.holdout).axes[0]
  heights = [p.get_height() for p in axis.patches][:2]
  assert heights == pytest.approx([0.2 / 0.15, 0.16 / 0.15])
  assert figures.before_and_after({}) is None
  assert set(explained.holdout) <= set(CHANNELS)
