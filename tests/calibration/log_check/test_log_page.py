"""The log's own page: a verdict of each channel with its sentence, what sampling rules out, logs without a data set."""

import pytest

from calibration.log_check import check_log
from calibration.log_check.log_page import channel_verdict, limits, log_sections
from qcar_twin.pages import Explorer
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from scripts import look
from tests.faults.falsities import NAMES, wander
from tests.qcar_twin.recordings.drives import STD, VEHICLE, folder_with, write_csv


def checked(**changes):
  time, columns = wander(3)
  run = Recording.from_columns("run", time, columns | {name: change(columns[name]) for name, change in changes.items()})
  return check_log(DataSet("lab", (run,), VEHICLE, STD))


def test_a_channel_that_others_agree_with_is_green_with_who_does():
  colour, text = channel_verdict(checked(), "yaw_rate")
  assert colour == "green" and "agrees with pose_yaw in turning (correlation 1.000)" in text


@pytest.mark.parametrize(
  ("channel", "change", "colour", "says"),
  [
    ("accel_y", lambda v: -v, "red", "set scale = -1"),
    ("yaw_rate", lambda v: 57.3 * v, "red", "is yaw_rate in deg/s? set scale = 0.01745 on yaw_rate in [channels]"),
    ("speed", lambda v: 1.1 * v, "amber", "speed reads +"),
    ("motor_voltage", lambda v: v + 5.0, "red", "set offset = -5 on motor_voltage"),
  ],
)
def test_a_false_channel_has_its_colour_and_cure(channel, change, colour, says):
  tone, text = channel_verdict(checked(**{channel: change}), channel)
  assert tone == colour and says in text


def test_sensors_that_geometry_confirms_are_not_blamed_for_one_that_contradicts_them():
  check = checked(accel_y=lambda v: -v)
  for channel in ("speed", "yaw_rate"):
    colour, text = channel_verdict(check, channel)
    assert colour != "red" and "say the contrary" not in text
  colour, text = channel_verdict(check, "yaw_rate")
  assert colour == "green" and "accel_y contradict it, and nothing confirms them" in text


def test_a_channel_that_nothing_witnesses_is_not_called_confirmed():
  time, columns = wander(3)
  run = Recording.from_columns("run", time, {name: columns[name] for name in ("motor_voltage", "speed", "accel_y")})
  colour, text = channel_verdict(check_log(DataSet("lab", (run,), VEHICLE, STD)), "accel_y")
  assert colour == "amber" and "unit, sign and age of speed and accel_y cannot be judged" in text


@pytest.mark.parametrize(("rate", "delay"), [(50.0, 20), (20.0, 50), (10.0, 100)])
def test_what_the_sampling_rules_out_is_said(rate, delay):
  time, columns = wander(3)
  time = time * 50.0 / rate
  text = limits([Recording.from_columns("run", time, {n: columns[n] for n in ("motor_voltage", "speed")})])
  assert f"no delay of it below {delay} ms" in text and "No recording is kept to judge by" in text
  assert "No pose was logged" in text


def test_traces_and_map_show_what_other_channels_say_of_the_same_motion():
  explorer = log_sections(checked())[0].figures[0]
  assert isinstance(explorer, Explorer)
  (run,) = explorer.runs
  assert run.route is not None and len(run.panels) == 6
  turning = next(panel for panel in run.panels if panel.title.startswith("yaw rate"))
  assert [line.label for line in turning.lines] == [
    "yaw rate",
    "slope of the heading",
    "speed × tan(steering) / wheelbase",
  ]


def test_look_needs_no_data_set_and_leaves_nothing_but_the_page(tmp_path, capsys):
  time, columns = wander(3)
  (tmp_path / "logs").mkdir()
  write_csv(tmp_path / "logs" / "run.csv", time, {NAMES[name]: values for name, values in columns.items()})
  check = look.main(look.Config((tmp_path / "logs" / "run.csv",), tmp_path / "page"))
  assert check is not None and "Fit to be used" in capsys.readouterr().out
  assert [p.name for p in (tmp_path / "logs").iterdir()] == ["run.csv"]
  assert sorted(p.name for p in (tmp_path / "page").iterdir()) == ["check.html", "check.json"]
  text = (tmp_path / "page" / "check.html").read_text(encoding="utf-8")
  assert "Verdict of each channel" in text and "agrees with pose_yaw in turning" in text


def test_look_shows_a_data_set_as_it_says_itself(tmp_path):
  time, columns = wander(4)
  (tmp_path / "set").mkdir()
  folder = folder_with(tmp_path / "set", time, columns)
  check = look.main(look.Config((folder,), tmp_path / "page"))
  assert check is not None and check.dataset.name == "lab"


def test_look_shows_a_log_that_is_no_drive_column_by_column_with_the_reason(tmp_path, capsys):
  time, columns = wander(5)
  write_csv(tmp_path / "run.csv", time, {"a1": columns["speed"], "b2": columns["yaw_rate"]})
  assert look.main(look.Config((tmp_path / "run.csv",), tmp_path / "page")) is None
  assert "Not readable as a drive yet: run.csv: needed channel 'motor_voltage' is missing" in capsys.readouterr().out
  text = (tmp_path / "page" / "log.html").read_text(encoding="utf-8")
  assert "Every column that changes" in text and "needed channel" in text
