"""Reproducers that strangers' logs gave, each checked against the right value that its README names."""

import shutil
import tomllib

import pytest

from calibration.log_check.check import check_log, load_to_check
from qcar_twin.recordings.first_dataset.place import logs_of, placed, with_rows
from qcar_twin.recordings.first_dataset.propose import propose
from tests import ROOT

CASES = ROOT.parent / "shared" / "cases"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="the reproducers are not here (../shared/cases)")


def case(name):
  (folder,) = CASES.glob(f"{name}_*")
  return folder


@pytest.fixture
def drafted(tmp_path, capsys):
  """A case -> its drafted table, proposal and folder."""

  def draft(name):
    files = [p for p in case(name).iterdir() if p.suffix != ".md"]
    for file in files:
      shutil.copyfile(file, tmp_path / file.name)
    read = with_rows(placed(tmp_path, logs_of((tmp_path,))))
    proposal = propose("case", [table for _, table in read])
    (tmp_path / "dataset.toml").write_text(proposal.text, encoding="utf-8")
    return tomllib.loads(proposal.text), proposal, tmp_path

  return draft


@pytest.fixture
def given(tmp_path):
  """A case with a dataset.toml -> its check."""

  def check(name):
    for file in case(name).iterdir():
      shutil.copyfile(file, tmp_path / file.name)
    return check_log(load_to_check(tmp_path))

  return check


def columns(table):
  return {channel: entry["column"] for channel, entry in table["channels"].items()}


def unscaled(table, *channels):
  return all(table["channels"][channel].get("scale", 1.0) == 1.0 for channel in channels)


def texts(folder, severity="beware"):
  return [f.text for f in check_log(load_to_check(folder)).of(severity)]


def test_01_the_stamp_is_the_clock_and_no_flag(drafted):
  table, _, folder = drafted("01")
  assert table["channels"]["time"] == {"column": "timestamp", "sort": True}
  assert any("1 of 3000 rows are out of order" in text for text in texts(folder))


def test_02_steps_are_added_up_and_the_index_is_left(drafted):
  table, _, folder = drafted("02")
  assert table["channels"]["time"] == {"column": "time", "scale": 1e-9, "steps": True}
  assert columns(table)["yaw_rate"] == "r"
  run = load_to_check(folder).recordings[0]
  assert (run["speed"].time[-1] - run["speed"].time[0]) / (len(run["speed"]) - 1) == pytest.approx(0.01, rel=0.01)


def test_03_commanded_and_measured_speed_are_told_apart(drafted):
  table, _, _ = drafted("03")
  assert columns(table) | {"motor_speed": ""} == {
    "time": "timestamp", "speed_command": "commanded_speed", "speed": "actual_speed", "motor_speed": "",
  }  # fmt: skip


def test_04_a_car_of_1_5_is_checked(given):
  assert given("04").of("spoils") == ()


def test_05_a_full_size_cars_speed_stays(drafted):
  table, _, folder = drafted("05")
  assert unscaled(table, "speed", "yaw_rate", "pose_yaw") and columns(table)["speed"] == "vx(m/s)"
  assert (columns(table)["yaw_rate"], columns(table)["pose_yaw"]) == ("omega(rad/s)", "phi(rad)")
  assert texts(folder, "spoils") == []


def test_07_names_of_the_trade(drafted):
  table, _, folder = drafted("07")
  right = {"yaw_rate": "dpsi_radps", "steering_command": "deltawheel_rad", "accel_x": "a_long", "accel_y": "a_lat"}
  assert right.items() <= columns(table).items() and unscaled(table, *right)
  assert texts(folder, "spoils") == []


def test_08_the_rate_is_asked_for_and_turns_per_second_are_radians(drafted):
  table, proposal, folder = drafted("08")
  assert proposal.missing == ("time",) and "# time = { rate = … }" in proposal.text and "50.0" not in proposal.text
  assert table["channels"]["motor_speed"]["scale"] == pytest.approx(6.283185307)
  assert table["channels"]["yaw_rate"]["scale"] == pytest.approx(0.0174532925)
  (folder / "dataset.toml").write_text(proposal.text.replace("# time = { rate = … }", "time = { rate = 50.0 }"))
  run = load_to_check(folder).recordings[0]
  assert run["motor_speed"].time[:3] == pytest.approx([0.0, 0.02, 0.04])


def test_10_without_a_drive_command_the_lateral_half_is_read(drafted):
  table, proposal, folder = drafted("10")
  assert not proposal.missing and table["vehicle"]["drive"] == "speed"
  assert any("the drive cannot be judged" in text for text in texts(folder))


def test_11_an_empty_log_is_left_out(drafted, capsys):
  table, _, _ = drafted("11")
  assert [entry["file"] for entry in table["recording"]] == ["good.csv"]
  assert "left out: empty.csv: has column names but no rows" in capsys.readouterr().out


def test_12_the_wheelbase_moves_and_not_the_steering(drafted):
  table, proposal, _ = drafted("12")
  car = table["vehicle"]
  assert unscaled(table, "steering_command")
  assert car["cg_to_front"] + car["cg_to_rear"] == pytest.approx(0.55, rel=0.03)
  assert "this log turns like a wheelbase of 0.5" in proposal.text and "cg_to_front" in car["std"]


def test_14_a_lag_of_a_second_is_one(drafted):
  _, _, folder = drafted("14")
  (text,) = texts(folder, "spoils")
  assert "accel_x is 1.00 ± " in text and "set late = 1.00 on accel_x" in text


def test_15_titles_of_a_scope_are_names(drafted):
  table, _, _ = drafted("15")
  taken = columns(table)
  assert taken["motor_voltage"] == "MOTOR VOLTAGE (V)(1)" and taken["speed"] == "FORWARD VELOCITY (m/s)(2)"
  assert taken["yaw_rate"] == "YAW RATE (rad/s)(2)" and taken["steering_command"] == "STEERING ANGLE (rad)"
  assert unscaled(table, "speed", "yaw_rate", "steering_command", "motor_voltage")


def test_16_spans_are_counted_from_the_files_start(drafted):
  _, _, folder = drafted("16")
  frozen, gap = (text for text in texts(folder) if "after the file's start" in text)
  assert "nothing was logged from 7.98 s to 10 s after the file's start (1759663727.000)" in gap
  assert "yaw_rate is frozen" in frozen and "from 16 s to 21.98 s after the file's start" in frozen


def test_18_two_sensors_that_agree_outweigh_a_limit(given):
  check = given("18")
  (car,) = check.of("spoils")  # one of 0.256 m, as its [vehicle] says nothing
  assert "the car turns like one of wheelbase 2.98 m, and [vehicle] says none" in car.text
  assert "set scale" not in car.text
  top = max(float(run["speed"].value.max()) for run in check.dataset.recordings)
  assert top == pytest.approx(36.3, abs=0.1)


@pytest.mark.parametrize("file", ["jump.csv", "no_jump.csv"])
def test_19_a_jump_is_said_and_hides_neither_scale(tmp_path, file):
  shutil.copyfile(case("19") / file, tmp_path / file)
  ((_, log),) = with_rows(placed(tmp_path, logs_of((tmp_path,))))
  (tmp_path / "dataset.toml").write_text(propose("case", [log]).text)
  said = " ".join(texts(tmp_path) + texts(tmp_path, "spoils"))
  for channel in ("yaw_rate", "speed"):
    assert float(said.split(f"{channel} reads +")[1].split()[0]) == pytest.approx(30.0, abs=0.2)
  assert ("the pose jumps by 22.7 m in 36 ms at 82.8 s" in said) == (file == "jump.csv")
