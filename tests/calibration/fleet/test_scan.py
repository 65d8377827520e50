"""A scan of a small fleet's folder: lines, exit codes, going on, the page."""

import json
import shutil

import pytest

from calibration.fleet.history import write_history
from calibration.fleet.logs import find_logs
from calibration.fleet.scan import line_of, read_lines, scan
from calibration.log_check.report import check_and_say
from qcar_twin.atomic_io import write_json
from qcar_twin.recordings.recording import RecordingError
from scripts import scan as scan_command
from scripts.__main__ import dispatch
from tests import ROOT
from tests.qcar_twin.recordings.drives import write_csv
from tests.qcar_twin.recordings.first_dataset.pairs import sample_columns, write_pair

SAMPLE = ROOT / "data" / "sample"


@pytest.fixture
def folder(tmp_path):
  """Two cars, two days, a data set among single files."""
  for car, day, name in (("red", "2026-11-03", "oval"), ("red", "2026-11-04", "circles_fast"), ("blue", "x", "oval")):
    place = tmp_path / "logs" / car / day
    place.mkdir(parents=True)
    shutil.copy(SAMPLE / f"{name}.csv", place)
  place = tmp_path / "logs" / "blue" / "set_20261105"
  place.mkdir()
  shutil.copy(SAMPLE / "oval.csv", place)
  head = (SAMPLE / "dataset.toml").read_text().partition("[[recording]]")[0]
  (place / "dataset.toml").write_text(head + '[[recording]]\nfile = "oval.csv"\nrole = "identify"\n')
  return tmp_path


def test_cars_and_days_are_read_from_where_logs_lie(folder):
  logs = {log.name: (log.car, log.day) for log in find_logs(folder / "logs")}
  assert logs["red/2026-11-04/circles_fast.csv"] == ("red", "2026-11-04")
  assert logs["blue/set_20261105"] == ("blue", "2026-11-05") and len(logs) == 4  # the set's own file is no other log


def test_a_data_set_is_of_the_car_that_its_own_folder_names(folder):
  """One data set a car, or a data set a day of each car; the folder that is scanned may be one itself."""
  for place in ("anna", "berta/2026-11-03", "berta/2026-11-04"):
    shutil.copytree(folder / "logs" / "blue" / "set_20261105", folder / "sets" / place)
  assert [(log.name, log.car) for log in find_logs(folder / "sets")] == [
    ("anna", "anna"), ("berta/2026-11-03", "berta"), ("berta/2026-11-04", "berta"),
  ]  # fmt: skip
  assert [log.car for log in find_logs(folder / "sets" / "anna")] == ["anna"]


def test_a_line_a_log_and_only_new_ones_again(folder):
  logs, lines, said = find_logs(folder / "logs"), folder / "scan.ndjson", []
  first = scan(logs, lines, like=SAMPLE, said=said.append)
  assert len(said) == 4 and {line["state"] for line in first} <= {"fit", "beware"}
  lines.write_text(lines.read_text().rstrip("\n")[:-30])  # killed in the middle of the last line
  again = scan(logs, lines, like=SAMPLE, said=said.append)
  assert len(said) == 5
  strip = lambda made: [{k: v for k, v in line.items() if k != "seconds"} for line in made]
  assert strip(again) == strip(first) and len(list(read_lines(lines))) == 4
  (folder / "logs" / "blue" / "x" / "oval.csv").write_text("time,motor_speed\n0,1\n")
  changed = scan(find_logs(folder / "logs"), lines, like=SAMPLE, said=said.append)
  assert len(said) == 6 and [line["state"] for line in changed].count("refused") == 1


def test_a_log_is_read_again_like_another_data_set(folder):
  logs, lines, said = find_logs(folder / "logs")[:1], folder / "scan.ndjson", []
  other = folder / "other"
  other.mkdir()
  text = (SAMPLE / "dataset.toml").read_text()
  (other / "dataset.toml").write_text(text + "\n# another\n")
  for like in (None, SAMPLE, other, SAMPLE, None):
    (line,) = scan(logs, lines, like=like, said=said.append)
    assert (line["like"] == "") == (like is None)
  assert len(said) == 3 and len({line["like"] for line in said}) == 3
  lines.write_text(json.dumps({k: v for k, v in said[0].items() if k != "like"}) + "\n")  # of an earlier version
  scan(logs, lines, said=said.append)
  assert len(said) == 4


def test_a_log_that_stands_straight_is_read_without_a_steering(tmp_path):
  shutil.copy(SAMPLE / "voltage_step_2V.csv", tmp_path / "straight.csv")
  line = line_of(find_logs(tmp_path)[0], "check")
  assert "KeyError" not in line["verdict"]


def test_a_pose_that_wanders_about_a_standing_car_is_no_driving_backwards(tmp_path):
  (tmp_path / "logs" / "car").mkdir(parents=True)
  shutil.copy(SAMPLE / "standstill.csv", tmp_path / "logs" / "car")
  (line,) = scan(find_logs(tmp_path / "logs"), tmp_path / "scan.ndjson", like=SAMPLE)
  assert line["state"] != "refused" and "backwards" not in str(line["findings"])


def test_exit_codes(folder, capsys):
  out = ["--out", str(folder / "out"), "--like", str(SAMPLE)]
  with pytest.raises(SystemExit) as refused:
    (folder / "logs" / "red" / "broken.csv").write_text("no,car\n1,2\n")
    dispatch(["scan", str(folder / "logs"), *out])
  assert refused.value.code == 1 and "broken.csv" in capsys.readouterr().out
  (folder / "logs" / "red" / "broken.csv").unlink()
  assert dispatch(["scan", str(folder / "logs"), *out]) == 0
  for words in (
    ["scan", str(folder / "nowhere")],
    ["scan", str(SAMPLE / "oval.csv")],
    ["scan", str(folder / "logs"), "--like", str(folder)],
  ):
    with pytest.raises(SystemExit) as misused:
      dispatch(words)
    assert misused.value.code == 2
  page = (folder / "out" / "history.html").read_text(encoding="utf-8")
  assert "4 logs of 2 cars" in page and json.loads((folder / "out" / "odd.json").read_text()) == []


def test_what_commands_have_written_below_the_logs_is_no_log(folder):
  """A scan's own lines, a check's document, and a fit's; a folder of nothing else holds no log."""
  logs = [log.name for log in find_logs(folder / "logs")]
  place = folder / "logs" / "out"
  scan(find_logs(folder / "logs"), place / "scan.ndjson", like=SAMPLE)
  check_and_say(SAMPLE, place / "check")
  write_json(place / "calibration" / "stages" / "fit.json", {"key": "a", "result": {"theta": [1.0, 2.0, 3.0]}})
  assert (place / "check" / "check.json").is_file()
  assert [log.name for log in find_logs(folder / "logs")] == logs
  with pytest.raises(RecordingError, match="holds no log, but results or settings in JSON, as .*json"):
    find_logs(place)


def test_a_log_in_json_is_scanned(tmp_path):
  time, columns = sample_columns(SAMPLE / "oval.csv")
  rows = zip(time, *columns.values(), strict=True)
  write_json(tmp_path / "oval.json", [dict(zip(("time", *columns), row, strict=True)) for row in rows])
  (line,) = scan(find_logs(tmp_path), tmp_path / "out" / "scan.ndjson", like=SAMPLE)
  assert line["log"] == "oval.json" and line["state"] in ("fit", "beware")


def test_a_line_that_is_none_is_said_with_its_number(tmp_path):
  (tmp_path / "scan.ndjson").write_text('{"log": "a", "stamp": [1, 2], "level": "check"}\nnonsense\n')
  with pytest.raises(ValueError, match="line 2"):
    list(read_lines(tmp_path / "scan.ndjson"))


def test_the_page_names_the_odd_car(tmp_path):
  lines = []
  for k in range(6):
    value = 0.6 if k == 3 else 0.9 + 0.002 * k
    lines.append(
      {"log": f"{k}.csv", "car": f"car_{k}", "day": "2026-11-03", "state": "fit", "verdict": "Fit to be used.",
       "parameters": {"friction_coefficient": {"value": value, "std": 0.01, "unit": "-"}}}
    )  # fmt: skip
  page, compared = write_history(lines, tmp_path / "history.html")
  assert [c.unit for c in compared if c.accused] == ["car_3"]
  assert "car car_3: friction_coefficient" in page.read_text(encoding="utf-8")


def test_the_command_hands_back_its_lines(folder, capsys):
  lines = scan_command.main(scan_command.Config(folder / "logs", folder / "out", like=SAMPLE))
  assert [line["log"] for line in lines] == sorted(line["log"] for line in lines) and len(lines) == 4
  assert "4 logs, 0 refused" in capsys.readouterr().out


def test_a_drive_and_its_motion_capture_are_one_log(tmp_path):
  from_sample = lambda name: sample_columns(SAMPLE / f"{name}.csv")
  for number, name in enumerate(("free_drive_a", "excitation_a"), 1):
    write_pair(tmp_path, f"run{number}", *from_sample(name), shift=1.5)
  logs = find_logs(tmp_path)
  assert [(log.name, [p.name for p in log.parts]) for log in logs] == [
    ("run1.csv", ["run1_mocap.csv"]),
    ("run2.csv", ["run2_mocap.csv"]),
  ]
  line = line_of(logs[1], "check")
  assert line["state"] in ("fit", "beware") and "pose" not in line["verdict"]


def test_a_drive_and_its_capture_in_a_folder_next_to_it_are_one_log(tmp_path):
  for number, name in enumerate(("free_drive_a", "excitation_a"), 1):
    write_pair(tmp_path / "seven", f"run{number}", *sample_columns(SAMPLE / f"{name}.csv"))
  for kind in ("car", "mocap"):
    (tmp_path / "seven" / kind).mkdir()
  for number in (1, 2):
    (tmp_path / "seven" / f"run{number}.csv").rename(tmp_path / "seven" / "car" / f"run{number}.csv")
    (tmp_path / "seven" / f"run{number}_mocap.csv").rename(tmp_path / "seven" / "mocap" / f"run{number}.csv")
  logs = find_logs(tmp_path)
  assert [(log.name, [p.parent.name for p in log.parts]) for log in logs] == [
    ("seven/car/run1.csv", ["mocap"]),
    ("seven/car/run2.csv", ["mocap"]),
  ]
  line = line_of(logs[0], "check")
  assert line["state"] in ("fit", "beware") and line["car"] == "seven"


def test_a_folder_with_a_file_a_topic_is_one_log_and_a_refusal_is_a_sentence(tmp_path):
  time, columns = sample_columns(SAMPLE / "free_drive_a.csv")
  topics = {"cmd": ("motor_voltage", "steering_command"), "imu": ("yaw_rate", "accel_y"), "encoder": ("motor_speed",)}
  for name, channels in topics.items():
    write_csv(tmp_path / f"{name}.csv", time, {channel: columns[channel] for channel in channels})
  (log,) = find_logs(tmp_path)
  assert (log.name, len(log.parts)) == ("cmd.csv", 2) and line_of(log, "check")["state"] in ("fit", "beware")
  for name in topics:
    (tmp_path / f"{name}.csv").write_text("a\n1\n", encoding="utf-8")
  assert line_of(log, "check")["verdict"].startswith("cmd.csv: only one column")
