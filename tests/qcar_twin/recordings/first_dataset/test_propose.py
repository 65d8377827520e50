"""A first dataset.toml finds back what was written under other names and in other units, and marks every guess."""

import dataclasses
import re
import tomllib

import numpy as np
import pytest

from qcar_twin.recordings.channels import DRIVE_COMMANDS
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset import propose
from qcar_twin.recordings.first_dataset.propose import MARK
from qcar_twin.recordings.first_dataset.roles import manoeuvre_of, share_out
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import Recording, RecordingError
from tests.qcar_twin.recordings.drives import drive, write_csv
from tests.qcar_twin.recordings.test_topic_maps import logged

DEG = 180.0 / np.pi


def foreign(seconds=12.0, seed=0):
  """Time and columns of a drive as somebody else logs it: other names, other units, a switch, things nobody needs."""
  time, own = drive(seconds, seed=seed)
  armed = np.ones(time.size)
  armed[:20] = 0.0
  wrapped = np.angle(np.exp(1j * own["pose_yaw"]))
  columns = {
    "u_motor [V]": own["motor_voltage"],
    "steer (deg)": DEG * own["steering_command"],
    "motor_rpm": own["motor_speed"] * 60.0 / (2.0 * np.pi),
    "imu ax": own["accel_x"] / 9.80665,
    "imu ay": own["accel_y"] / 9.80665,
    "gyro_z": DEG * own["yaw_rate"],
    "mocap x mm": 1000.0 * own["pose_x"],
    "mocap y mm": 1000.0 * own["pose_y"],
    "mocap heading": wrapped,
    "armed": armed,
    "seq": np.arange(float(time.size)),
    "lap": np.zeros(time.size),
  }
  return 1000.0 * time, columns, own


def written(folder, text):
  (folder / "dataset.toml").write_text(text, encoding="utf-8")
  return tomllib.loads(text)


def proposed(folder, *files):
  return propose("lab", [read_table(folder / file, file) for file in files])


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
  folder = tmp_path_factory.mktemp("lab")
  time, columns, own = foreign()
  rows = np.column_stack([time, *columns.values()])
  header = ",".join(("stamp", *columns))
  np.savetxt(folder / "run.csv", rows, "%.17g", ",", header=header, comments="")
  proposal = proposed(folder, "run.csv")
  return folder, proposal, written(folder, proposal.text), own


def test_channels_units_switch_and_wrapping_are_found(lab):
  folder, proposal, table, own = lab
  assert proposal.missing == ()
  (run,) = DataSet.load(folder).recordings
  assert set(run.channels) == set(own)
  for channel in set(own) - {"motor_voltage"}:
    assert run[channel].value == pytest.approx(own[channel], rel=1e-6, abs=1e-9), channel
  volts = run["motor_voltage"].value
  assert (volts[:20] == 0.0).all() and volts[20:] == pytest.approx(own["motor_voltage"][20:])
  assert table["channels"]["motor_voltage"]["gate"] == "armed" and table["channels"]["time"]["scale"] == 1e-3


def test_every_line_that_is_guessed_says_so_and_why(lab):
  _, proposal, table, _ = lab
  section = ""
  for line in proposal.text.splitlines():
    if line.startswith("["):
      section = line
    elif re.match(r"\w+ = ", line) and not line.startswith(("name", "file")):
      assert f"  # {MARK} " in line and len(line.split(MARK)[1]) > 5, f"{section} {line}"
  assert "# columns that are not used: seq, lap" in proposal.text
  assert len(proposal.guesses) == proposal.text.count(f"  # {MARK} ")
  assert "times motor_speed x yaw_rate: g" in proposal.text
  assert table["vehicle"]["std"]["mass"] == pytest.approx(0.3 * table["vehicle"]["mass"])


def test_a_share_of_full_lock_is_scaled_by_how_the_car_turned(tmp_path):
  time, own = drive(20.0)
  share = np.clip(own["steering_command"] / 0.3, -1.0, 1.0)
  columns = {name: own[name] for name in ("motor_voltage", "motor_speed", "yaw_rate")} | {"servo": -share}
  write_csv(tmp_path / "run.csv", time, columns)
  steering = written(tmp_path, proposed(tmp_path, "run.csv").text)["channels"]["steering_command"]
  assert steering["scale"] == pytest.approx(-0.3, rel=0.03) and "offset" not in steering


@pytest.mark.parametrize(("day", "order"), [(1.7e9, ["steps.csv", "circles.csv", "free.csv"]), (0.0, None)])
def test_files_are_listed_as_their_dates_say_that_they_were_driven(tmp_path, day, order):
  """A name's place in the alphabet says nothing of heat and charge; a clock that begins at 0 neither."""
  for later, name in enumerate(("steps", "circles", "free")):
    time, own = drive(12.0, seed=later)
    columns = {channel: own[channel] for channel in ("motor_voltage", "motor_speed", "yaw_rate")}
    write_csv(tmp_path / f"{name}.csv", day + 60.0 * later * (day > 0.0) + time, columns)
  names = ("circles.csv", "free.csv", "steps.csv")
  table = written(tmp_path, proposed(tmp_path, *names).text)
  assert [part["file"] for part in table["recording"]] == (order or list(names))
  assert {r.name: r.before for r in DataSet.load(tmp_path).recordings}["steps" if order else "circles"] == (0.0, 0.0)


def test_a_servo_pulse_is_centred(tmp_path):
  time, own = drive(20.0)
  pulse = 1500.0 + 500.0 * own["steering_command"] / 0.3
  columns = {name: own[name] for name in ("motor_voltage", "motor_speed", "yaw_rate")} | {"servo_us": pulse}
  write_csv(tmp_path / "run.csv", time, columns)
  written(tmp_path, proposed(tmp_path, "run.csv").text)
  (run,) = DataSet.load(tmp_path).recordings[:1]
  there = own["steering_command"][: len(run["steering_command"])]
  assert run["steering_command"].value == pytest.approx(there, abs=0.012)


def test_values_that_a_slower_publisher_holds_are_found(tmp_path):
  time, own = drive(12.0)
  held = {name: np.repeat(own[name][::5], 5)[: time.size] for name in ("yaw_rate", "accel_x")}
  write_csv(
    tmp_path / "run.csv", time, {"motor_voltage": own["motor_voltage"], "motor_speed": own["motor_speed"], **held}
  )
  channels = written(tmp_path, proposed(tmp_path, "run.csv").text)["channels"]
  assert channels["yaw_rate"]["hold"] and channels["accel_x"]["hold"] and "hold" not in channels["motor_speed"]
  assert len(DataSet.load(tmp_path).recordings[0]["yaw_rate"]) < time.size / 4


def test_a_voltage_that_stays_is_the_batterys(tmp_path):
  time, own = drive(12.0)
  columns = {"throttle": own["motor_voltage"] / 8.0, "voltage": 11.4 - 0.01 * time, "speed": 0.003 * own["motor_speed"]}
  write_csv(tmp_path / "run.csv", time, columns)
  table = written(tmp_path, proposed(tmp_path, "run.csv").text)
  assert set(table["channels"]) == {"time", "motor_duty", "speed", "battery_voltage"}
  assert table["vehicle"]["drive"] == "duty" and table["vehicle"]["supply_voltage"] == pytest.approx(11.34)


def test_a_duty_without_a_battery_has_a_usual_supply_as_a_guess(tmp_path):
  time, own = drive(12.0)
  write_csv(tmp_path / "run.csv", time, {"throttle": own["motor_voltage"] / 8.0, "speed": 0.003 * own["motor_speed"]})
  text = proposed(tmp_path, "run.csv").text
  (line,) = [line for line in text.splitlines() if line.startswith("supply_voltage")]
  assert "guess: a usual battery's" in line and written(tmp_path, text)["vehicle"]["supply_voltage"] == 12.0


@pytest.mark.parametrize("name", ["qcar", "f1tenth", "ackermann", "qcar_twin"])
def test_topics_of_a_known_car_choose_its_map(tmp_path, name):
  write_csv(tmp_path / "run.csv", drive(12.0)[0], logged(name))
  proposal = proposed(tmp_path, "run.csv")
  assert written(tmp_path, proposal.text)["map"] == name and proposal.missing == ()
  (run, *_) = DataSet.load(tmp_path).recordings
  assert {"steering_command", "yaw_rate"} <= set(run.channels)


def test_what_is_missing_is_named_in_the_file_and_apart(tmp_path):
  time, own = drive(12.0)
  write_csv(tmp_path / "run.csv", time, {"log(2)": own["motor_voltage"], "log(3)": own["motor_speed"]})
  proposal = proposed(tmp_path, "run.csv")
  written(tmp_path, proposal.text)
  assert proposal.missing == ("motor_speed or speed", " or ".join(DRIVE_COMMANDS))
  assert "# needed, and no column says it is this; fill it in" not in proposal.text.split("[channels]")[0]
  assert "columns that are not used: log(2), log(3)" in proposal.text
  assert re.search(r"(?m)^# log\(2\): [-.\d]+ to [.\d]+$", proposal.text), "the range tells a person which it is"
  with pytest.raises(RecordingError, match="needed channel 'motor_voltage' is missing"):
    DataSet.load(tmp_path)


def test_a_steering_without_a_speed_is_no_drive_by_hand_and_all_that_is_missing_is_said_at_once(tmp_path):
  time, columns = drive()
  write_csv(tmp_path / "log.csv", time, {"servo [rad]": columns["steering_command"], "gyro z": columns["yaw_rate"]})
  proposal = proposed(tmp_path, "log.csv")
  assert proposal.missing == ("motor_speed or speed", " or ".join(DRIVE_COMMANDS))
  assert "no column says it is the drive's command" in proposal.text
  written(tmp_path, proposal.text)
  with pytest.raises(
    RecordingError, match=r"neither 'motor_speed' nor 'speed'.*no column is mapped to a command of the"
  ):
    DataSet.load(tmp_path)


def test_names_with_quotes_and_odd_signs_survive(tmp_path):
  time, own = drive(12.0)
  columns = {'motor "voltage" é': own["motor_voltage"], "motor\\speed": own["motor_speed"]}
  np.savez(tmp_path / "run.npz", time=time, **columns)
  table = written(tmp_path, proposed(tmp_path, "run.npz").text)
  assert table["channels"]["motor_voltage"]["column"] == 'motor "voltage" é'
  assert table["channels"]["motor_speed"]["column"] == "motor\\speed"


def test_a_long_log_with_stamps_of_the_day_is_cut_by_time(tmp_path):
  time, own = drive(60.0)
  write_csv(
    tmp_path / "run.csv", 1_725_000_000.0 + time, {name: own[name] for name in ("motor_voltage", "motor_speed")}
  )
  written(tmp_path, proposed(tmp_path, "run.csv").text)
  parts = DataSet.load(tmp_path).recordings
  assert [run.role for run in parts] == ["identify", "validate", "holdout"]
  assert [run.duration for run in parts] == pytest.approx([36.0, 12.0, 12.0], abs=0.02)


def runs(count, seconds=12.0, name="run"):
  time, own = drive(seconds)
  make = lambda k: Recording.from_columns(f"{name}_{k}", time, own, file=f"{name}_{k}.csv")
  return [make(k) for k in range(count)]


def test_roles_are_shared_out_among_files_or_by_time():
  assert [part.role for part in share_out(runs(10), "")].count("holdout") == 2
  assert [part.role for part in share_out(runs(3), "")] == ["identify", "validate", "holdout"]
  assert [part.role for part in share_out(runs(1), "")] == ["identify"]  # too short to be cut
  long = share_out(runs(1, 60.0), "")
  assert [(part.role, part.begin, part.end) for part in long] == [
    ("identify", None, pytest.approx(36.0, abs=0.1)),
    ("validate", pytest.approx(36.0, abs=0.1), pytest.approx(48.0, abs=0.1)),
    ("holdout", pytest.approx(48.0, abs=0.1), None),
  ]
  kinds = share_out([*runs(5), *runs(5, name="step")], "")
  for kind in ("run", "step"):
    assert {part.role for part in kinds if part.file.startswith(kind)} == {"identify", "validate", "holdout"}


def test_steps_and_standstill_are_labelled_and_other_driving_is_not():
  (run,) = runs(1)
  time = run["motor_voltage"].time
  made = lambda volts, angle: dataclasses.replace(
    Recording.from_columns("r", time, {"motor_voltage": volts, "steering_command": angle, "speed": volts}), file="r.csv"
  )
  zero = np.zeros(time.size)
  step = np.where(time > 2.0, 1.5, 0.0)
  assert manoeuvre_of(made(step, zero), "voltage_step")[0] == "voltage_step"
  assert manoeuvre_of(made(zero, zero), "voltage_step")[0] == "standstill"
  assert manoeuvre_of(made(step, 0.1 * np.sin(time)), "voltage_step")[0] == ""
  assert manoeuvre_of(run, "voltage_step")[0] == ""


def test_a_word_in_a_sensors_column_leaves_it_one_and_is_named_when_the_log_is_read(tmp_path):
  time, own = drive(12.0)
  speed = (0.003 * own["motor_speed"]).astype(object)
  speed[400] = "ERR"
  words = np.where(np.arange(time.size) % 3, "AUTO", "2")
  write_csv(tmp_path / "run.csv", time, {"throttle": own["motor_voltage"] / 8.0, "speed": speed, "mode": words})
  table = written(tmp_path, proposed(tmp_path, "run.csv").text)
  assert table["channels"]["speed"]["column"] == "speed" and "mode" not in str(table["channels"])
  with pytest.raises(RecordingError, match="column 'speed' has 'ERR' in row 401, .*leave the cell blank"):
    DataSet.load(tmp_path)


def test_what_goes_where_no_other_goes_is_fitted_and_a_like_of_the_others_judges():
  time = np.arange(0.0, 12.0, 0.01)

  def driven(k: int, steering: np.ndarray) -> Recording:
    columns = {"motor_voltage": np.full(time.size, 2.0), "steering_command": steering, "speed": np.ones(time.size)}
    return Recording.from_columns(f"run_{k}", time, columns, file=f"run_{k}.csv")

  slalom, steps = 0.3 * np.sin(2.0 * time), 0.3 * np.sign(np.sin(2.0 * time))
  smooth = [slalom, slalom, slalom, slalom]
  judges = lambda made: {part.role: part.file for part in share_out(made, "") if part.role != "identify"}
  alike = judges([driven(k, s) for k, s in enumerate(smooth)])
  assert alike == {"validate": "run_2.csv", "holdout": "run_3.csv"}
  for at in (2, 3):  # the only one in which the servo's rate shows
    made = [driven(k, steps if k == at else s) for k, s in enumerate(smooth)]
    assert f"run_{at}.csv" not in judges(made).values() and len(judges(made)) == 2
  wide = judges([driven(k, 2.0 * s if k == 3 else s) for k, s in enumerate(smooth)])
  assert wide["holdout"] != "run_3.csv"
