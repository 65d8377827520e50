"""The report opens on the errors, shows every section, and says nothing that its verdict does not rest on."""

import dataclasses
import re

import numpy as np
import pytest

from calibration.diagnosis.decision.structure import Leftover
from calibration.diagnosis.holdout_errors import recovered_share, share_taken_off
from calibration.diagnosis.report import figures
from calibration.diagnosis.report.causes import channel_changes, effect_on_car
from calibration.diagnosis.report.curves import Curve
from calibration.diagnosis.report.demonstration import NOTHING_SHOWN, Demonstration
from calibration.diagnosis.report.errors import multiples, parting
from calibration.diagnosis.report.further import Further
from calibration.diagnosis.report.page import facts, report_sections, verdict, write_report
from calibration.fitting.observations import CHANNELS
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages import Explorer, Section
from qcar_twin.pages.charts import unpacked
from tests.calibration.diagnosis.diagnosis_results import decision_of, diagnosis_of

SECTIONS = (
  "Errors before and after", "What was left out of the twin", "What is still unexplained, and where",
  "Where the missing physics acts", "The repaired model", "Parameters and how far they moved",
  "The evidence in numbers", "What to drive next", "What these recordings cannot show", "Time and warnings",
)  # fmt: skip


def section(diagnosis, title, shown=NOTHING_SHOWN):
  """The section with a title."""
  return next(s for s in report_sections(diagnosis, shown) if s.title == title)


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


def test_what_a_later_stage_adds_stands_behind_the_repaired_model(explained, tmp_path):
  added = Further("Curves found nothing.", [("curves", "none")], [Section("Free curves: the maps", "flat")])
  text = write_report(tmp_path, explained, further=added).read_text()
  assert text.index("The wheels point to one side") < text.index("Curves found nothing.") < text.index("<h2>")
  titles = re.findall(r"<h2>(.*?)</h2>", text)
  assert titles.index("Free curves: the maps") == titles.index("The repaired model") + 1
  assert len(titles) == len(SECTIONS) + 1 and "<dt>curves</dt>" in text


def test_every_section_says_something(explained):
  for section in report_sections(explained):
    assert section.text.strip(), section.title
    for table in section.tables:
      assert table.rows, table.caption
  assert [s.title for s in report_sections(explained)] == list(SECTIONS)


def test_the_model_section_has_equation_amount_and_effect(explained):
  model = section(explained, "The repaired model")
  assert "delta" in model.text and any("°" in str(cell) for row in model.tables[0].rows for cell in row)
  assert "On the fitted recordings it moves" in section(explained, "What was left out of the twin").text


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


def test_the_page_opens_on_errors_in_per_cent_and_in_multiples_of_the_noise(explained):
  first = report_sections(explained)[0]
  gone = 100 * recovered_share(explained.holdout)
  assert (
    f"On held-out recordings the repair removes {gone:.0f} % of the squared error above sensor noise." in first.text
  )
  assert "repaired twin errs by 1.0 to 1.1 times the sensor noise, most in yaw rate (0.16 rad/s)." in first.text
  rows = {row[0]: row for row in first.tables[0].rows}
  assert rows["yaw rate [rad/s]"][1:5] == (0.2, 0.16, 0.15, pytest.approx(0.16 / 0.15))
  assert rows["lateral acceleration [m/s²]"][6] == "−35.0 to −20.0"


def test_the_first_chart_is_where_the_two_twins_part_most(explained):
  chart = report_sections(explained)[0].figures[0]
  measured, before, wrong_before, after, wrong_after = (unpacked(t["y"]) for t in chart.data()["traces"])
  np.testing.assert_allclose(wrong_before, before - measured, atol=1e-6)
  np.testing.assert_allclose(wrong_after, after - measured, atol=1e-6)
  assert np.mean(wrong_after**2) < np.mean(wrong_before**2)
  assert "in which the two twins part most" in chart.caption and "held-out recordings" in chart.caption


def test_what_one_mechanism_takes_off_is_all_that_is_removed(explained):
  table = section(explained, "What was left out of the twin").tables[0]
  replay, name = explained.replay, "steering_offset"
  rms = lambda errors, c: float(np.sqrt(np.mean(errors[replay.observations.select(c)] ** 2)))
  fits = {c: dataclasses.replace(f, before=rms(replay.before, c), after=rms(replay.after, c), noise_floor=1e-3,
                                 driving_noise=0.0) for c, f in explained.holdout.items()}  # fmt: skip
  assert share_taken_off(replay, fits, name) == pytest.approx(recovered_share(fits))
  assert share_taken_off(replay, fits, "side_force") is None
  assert table.rows[0][0] == name and "±" in table.rows[0][1] and table.rows[0][2] == 0.97


def test_no_mismatch_still_says_where_the_largest_residual_is(nothing, tmp_path):
  where = section(nothing, "Where the twin errs most")
  assert "Nothing is claimed" in where.text and where.tables[0].rows
  assert "No mechanism is claimed" in section(nothing, "What was left out of the twin").text
  assert "nothing is added" in section(nothing, "The repaired model").text
  assert "no error can be shown" in report_sections(nothing)[0].text
  assert "no more structure" in section(nothing, "What is still unexplained, and where").text
  assert "a gap in run_1" in section(nothing, "Time and warnings").text
  assert "no missing physics" in verdict(nothing)
  assert write_report(tmp_path, nothing).exists()


def test_without_a_repair_the_page_opens_on_the_recalibrated_twin(clean_pool):
  first = report_sections(diagnosis_of(clean_pool, (), "no_mismatch"))[0]
  assert "On held-out recordings the recalibrated twin errs by 1.0 to 1.1 times the sensor noise" in first.text
  assert [t["name"] for t in first.figures[0].data()["traces"]] == [
    "measured",
    "recalibrated twin",
    "recalibrated twin",
  ]


def test_an_unexplained_case_names_the_best_nameless_error(clean_pool):
  case = diagnosis_of(clean_pool, (), "unexplained", unknown="unknown_force_y")
  assert "an unknown force across the car" in verdict(case)
  rest = section(case, "What is still unexplained, and where")
  assert "An unknown change of the steering angle explains most." in rest.text
  assert rest.tables[0].rows[0][::2] == ("an unknown change of the steering angle", 100)
  assert rest.tables[0].rows[1][2] == 25
  nothing = dataclasses.replace(case.location, degrees=dict.fromkeys(case.location.degrees, -1.0))
  rest = section(dataclasses.replace(case, location=nothing), "What is still unexplained, and where")
  assert "None explains any of it." in rest.text and not rest.tables


def test_residual_structure_is_told_in_the_words_of_the_page(clean_pool):
  left = (Leftover("accel_y", "heading", ("pose_yaw",), 3.0, size=0.25),)
  case = diagnosis_of(clean_pool, (), "unexplained")
  case = dataclasses.replace(case, decision=dataclasses.replace(case.decision, leftovers=left))
  rows = section(case, "What is still unexplained, and where").tables[0].rows
  assert rows == [("lateral acceleration", "turns with the heading", "heading", 25.0)]


def test_a_page_on_a_named_cause_does_not_speak_of_nameless_ones(explained, nothing):
  for case in (explained, nothing):
    text = " ".join(s.text + " ".join(str(t.caption) for t in s.tables) for s in report_sections(case))
    assert case.location.degrees
    assert not [word for word in ("unknown", "nameless", "without a name", "unnamed") if word in text.lower()]


def test_nats_stand_in_one_section_and_are_explained_there(explained, tmp_path):
  counts = [s.title for s in report_sections(explained) if "nat" in re.findall(r"[a-z]+", s.text)]
  assert counts == ["The evidence in numbers"]
  text = write_report(tmp_path, explained).read_text()
  assert "nats" not in text[: text.index("<h2>")]


def test_one_name_for_one_quantity(explained, tmp_path):
  text = write_report(tmp_path, explained).read_text()
  shown = re.sub(r"<(script|style).*?</\1>", "", text, flags=re.S)
  shown = shown[: shown.index("<h2>Parameters")] + shown[shown.index("<h2>The evidence") :]
  assert not re.findall(r"accel[_ ][xy]|m/s\^2|acceleration a(?:cross|long)", shown)


def test_facts_go_with_the_verdict(explained, nothing):
  stated = dict(facts(explained))
  assert stated["Verdict"] == "explained" and stated["What remains"] == "1.0 to 1.1 times the sensor noise"
  channel = parting(explained).channel
  fit, words = explained.holdout[channel], RESIDUALS[channel].words
  assert stated[f"Error of {words}, held-out recordings"].startswith(f"{fit.before:.3g} → {fit.after:.3g} ")
  assert facts(nothing) == [("Verdict", "nothing is missing")]


def test_parameters_are_in_sight_with_their_shift_and_what_ended_at_a_bound(explained):
  pool = explained.pool
  table = section(explained, "Parameters and how far they moved").tables[0]
  assert not dataclasses.replace(table, rows=20 * list(table.rows)).folded
  rows = {row[0]: row for row in table.rows}
  assert rows["mass"][2] == "2.700 ± 0.020" and "±" in rows["mass"][3]
  assert rows["mass"][4] == pytest.approx((pool.base.estimate("mass")[0] - 2.7) / 0.02)
  base = dataclasses.replace(pool.base, values=pool.base.values.copy())
  base.values[base.free.index("mass")] = base.free["mass"].upper
  bound = dataclasses.replace(explained, pool=dataclasses.replace(pool, models=pool.models | {frozenset(): base}))
  moved = section(bound, "Parameters and how far they moved")
  assert "mass: at its upper bound" in moved.text
  assert "at its upper bound" in {row[0]: row for row in moved.tables[0].rows}["mass"][6]


def test_untestable_and_concealed_effects_are_listed(explained):
  blind = section(explained, "What these recordings cannot show")
  assert "gyro_scale" in blind.text and "does not mean that the car is free of them" in blind.text
  rows = {row[0]: row for row in blind.tables[0].rows}
  assert rows["gyro_scale"][3] == "no" and rows["steering_offset"][3] == "yes"
  assert rows["gyro_scale"][1] < 1.0 < rows["steering_offset"][1]
  sizes = {row[0]: row for row in blind.tables[1].rows}
  assert sizes["gyro_scale"][2] == "never" and float(sizes["quadratic_drag"][2]) > 0.0
  assert "steering_offset" not in sizes, "what was found needs no such size"


def test_the_next_drive_is_proposed_when_known(explained):
  assert section(explained, "What to drive next").text.startswith("Nothing")
  wish = {"manoeuvre": "chirp_fast", "separates": ["steering_delay", "steering_lag"], "predicted_nats": 45.0}
  wanted = section(dataclasses.replace(explained, next_experiment=wish), "What to drive next").text
  assert wanted == (
    "Drive chirp_fast. It should distinguish steering_delay from steering_lag, with an expected evidence of about 45"
    " nats."
  )


def test_the_explorer_shows_measured_before_and_after(explained):
  drawn = figures.explorer(explained.pool, explained.model.residual, explained.location)
  assert isinstance(drawn, Explorer) and drawn.runs[0].name == explained.location.time[0].recording
  panel = next(p for p in drawn.runs[0].panels if p.title.startswith("yaw rate"))
  assert [ln.who for ln in panel.lines] == ["measured", "before", "twin"]
  measured, before, after = (ln.value for ln in panel.lines)
  assert np.mean((after - measured) ** 2) < np.mean((before - measured) ** 2)
  assert len(drawn.moments) == len(explained.location.time) and drawn.runs[0].shaded
  assert all(run.route is not None for run in drawn.runs) and "Click the map" in drawn.caption


def test_without_a_repair_or_a_pose_there_is_neither_after_nor_map(nothing):
  drawn = figures.explorer(nothing.pool, nothing.model.residual, nothing.location)
  panel = next(p for p in drawn.runs[0].panels if p.title.startswith("yaw rate"))
  assert [ln.who for ln in panel.lines] == ["measured", "before"]
  assert drawn.runs[0].route is None and "Click the map" not in drawn.caption


def test_curves_stand_beside_the_forms_that_shape_them(explained):
  x = np.linspace(-1.0, 1.0, 5)
  points = {"nominal": (x, x), "before": (x, x), "twin": (x, x + 0.1)}
  curves = (Curve("Steering map", "command", "angle", ("steering",), "delta = u", points),
            Curve("Drive map", "V", "m/s", ("drive",), "torque = a u", points))  # fmt: skip
  model = section(explained, "The repaired model", Demonstration(curves=curves))
  rows = [("Steering map", "delta = u", "steering_offset"), ("Drive map", "torque = a u", "nothing")]
  assert model.tables[-1].rows == rows
  chart = model.figures[0].data()
  assert [t["name"] for t in chart["traces"]] == 2 * ["nominal car", "recalibrated twin", "repaired twin"]


def test_why_there_is_no_film_is_said(explained):
  shown = Demonstration(no_film="There is no film: no OpenGL.")
  assert "There is no film: no OpenGL." in section(explained, SECTIONS[3], shown).text


def test_a_repair_that_does_not_help_is_not_praised(explained):
  worse = {n: dataclasses.replace(f, after=1.1 * f.before) for n, f in explained.holdout.items()}
  text = report_sections(dataclasses.replace(explained, holdout=worse))[0].text
  assert "does not lower the error" in text and "removes" not in text
  assert "removes" in report_sections(explained)[0].text


def test_shares_through_the_recordings_end_at_the_whole(explained):
  assert explained.location.evidence.sum() > 0.0
  trace = figures.share_over_time(explained.pool.problem.observations, explained.location).data()["traces"][0]
  assert unpacked(trace["y"])[-1] == pytest.approx(100.0, rel=1e-6)
  assert np.all(np.diff(unpacked(trace["x"])) >= 0)


def test_evidence_bars_keep_the_order_of_the_ranking():
  names = ["steering_delay", "steering_lag", "side_force", "payload", "cogging"]
  ranking = tuple((name, 100.0 - 40.0 * i) for i, name in enumerate(names))
  trace = figures.ranked_evidence(decision_of("explained", ("steering_delay",), ranking=ranking)).data()["traces"][0]
  assert trace["y"] == names[:4]  # the last explains nothing
  assert trace["x"] == [100.0, 60.0, 20.0, 0.0]
  assert trace["marker"]["color"] == ["@twin", "@nominal", "@nominal", "@nominal"]


def test_a_multiple_beyond_a_hundredfold_has_no_digits(explained):
  pairs = zip(explained.holdout.items(), (3.0, 3e3), strict=False)
  fits = {n: dataclasses.replace(f, noise_floor=f.after / size, driving_noise=0.0) for (n, f), size in pairs}
  assert multiples(fits) == "3.0 to more than 100 times the sensor noise"


def test_errors_are_drawn_in_multiples_of_the_noise(explained):
  chart = figures.before_and_after(explained.holdout, "held-out recordings")
  assert chart is not None
  before, after = chart.data()["traces"]
  assert (before["y"][0], after["y"][0]) == pytest.approx((0.2 / 0.15, 0.16 / 0.15), rel=1e-4)
  assert after["error_y"]["array"][0] == pytest.approx((0.2 * 0.9 - 0.16) / 0.15, rel=1e-3)
  assert figures.before_and_after({}, "held-out recordings") is None
  assert set(explained.holdout) <= set(CHANNELS)
