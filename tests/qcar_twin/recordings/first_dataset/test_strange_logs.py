"""Logs of strangers: clocks that are none, names of the trade, cars of another size, no drive command."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.recordings.drives import VEHICLE, drive, write_csv
from tests.qcar_twin.recordings.first_dataset.test_propose import DEG, proposed, written


def log(folder, time, columns, clock="time"):
  """Write run.csv with a clock of this name, and the table and text that are proposed for it."""
  write_csv(folder / "run.csv", time, columns)
  text = (folder / "run.csv").read_text(encoding="utf-8")
  (folder / "run.csv").write_text(text.replace("time", clock, 1), encoding="utf-8")
  proposal = proposed(folder, "run.csv")
  return written(folder, proposal.text), proposal


def speed_of(own):
  return own["motor_speed"] * VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"]


def test_a_clock_with_a_row_out_of_order_is_taken_before_a_flag_that_rises(tmp_path):
  time, own = drive(20.0)
  stamp = 1759663727.0 + time
  stamp[[900, 901]] = stamp[[901, 900]]
  flag = (time > 4.0).astype(float)
  table, proposal = log(
    tmp_path,
    stamp,
    {"throttle": own["motor_voltage"] / 8.0, "velocity": speed_of(own), "gps_available": flag},
    "timestamp",
  )
  assert table["channels"]["time"] == {"column": "timestamp", "sort": True}
  assert "1 of 2000 rows are out of order" in proposal.text
  assert len(DataSet.load(tmp_path).recordings[0]["speed"]) == 2000


def test_steps_under_the_name_of_time_add_up_and_an_index_without_a_name_is_no_clock(tmp_path):
  time, own = drive(20.0)
  columns = {
    "time": np.full(time.size, 1e7),
    "vx": speed_of(own),
    "r": own["yaw_rate"],
    "throttle": own["motor_voltage"] / 8.0,
  }
  table, _ = log(tmp_path, np.arange(time.size) + 2.0, columns, "")
  assert table["channels"]["time"] == {"column": "time", "scale": 1e-9, "steps": True}
  assert table["channels"]["yaw_rate"]["column"] == "r" and "unnamed_1" not in str(table["channels"])
  (run,) = DataSet.load(tmp_path).recordings
  assert run["speed"].time == pytest.approx(time)


def test_what_was_commanded_is_not_what_was_measured(tmp_path):
  time, own = drive(20.0)
  held = np.repeat(speed_of(own)[::100], 100)
  table, proposal = log(tmp_path, time, {"commanded_speed": held, "actual_speed": speed_of(own)})
  assert table["channels"]["speed_command"]["column"] == "commanded_speed" and not proposal.missing
  assert table["channels"]["speed"]["column"] == "actual_speed" and table["vehicle"]["drive"] == "speed"


def test_of_two_speeds_without_a_word_the_stepped_one_is_not_measured(tmp_path):
  time, own = drive(20.0)
  held = np.repeat(speed_of(own)[::100], 100)
  columns = {"VELOCITY (m/s)(1)": held, "VELOCITY (m/s)(2)": speed_of(own), "MOTOR VOLTAGE (V)": own["motor_voltage"]}
  table, _ = log(tmp_path, time, columns)
  assert table["channels"]["speed"]["column"] == "VELOCITY (m/s)(2)"


def test_names_of_vehicle_dynamics_are_known(tmp_path):
  time, own = drive(20.0)
  columns = {
    "throttle_pct": 100.0 * own["motor_voltage"] / 8.0,
    "deltawheel_rad": own["steering_command"],
    "vx_mps": speed_of(own),
    "dpsi_radps": own["yaw_rate"],
    "a_long": own["accel_x"],
    "a_lat": own["accel_y"],
  }
  table, _ = log(tmp_path, time, columns, "t")
  taken = {channel: entry["column"] for channel, entry in table["channels"].items()}
  assert taken["yaw_rate"] == "dpsi_radps" and taken["steering_command"] == "deltawheel_rad"
  assert (taken["accel_x"], taken["accel_y"]) == ("a_long", "a_lat")
  assert all("scale" not in table["channels"][channel] for channel in ("yaw_rate", "steering_command", "accel_y"))


def test_a_log_without_a_clock_is_asked_for_its_rate(tmp_path):
  time, own = drive(20.0)
  columns = {"rps": own["motor_speed"] / (2.0 * np.pi), "throttle": own["motor_voltage"] / 8.0}
  columns["gyr_z"] = DEG * own["yaw_rate"]
  table, proposal = log(tmp_path, 0.0 * time, columns, "idle")
  assert proposal.missing == ("time",) and "# time = { rate = … }" in proposal.text
  assert table["channels"]["yaw_rate"]["column"] == "gyr_z"
  written(tmp_path, proposal.text.replace("# time = { rate = … }", "time = { rate = 100.0 }"))
  run = DataSet.load(tmp_path).recordings[0]
  assert run["yaw_rate"].value == pytest.approx(own["yaw_rate"]) and run["yaw_rate"].time == pytest.approx(time)
  assert run["motor_speed"].value == pytest.approx(own["motor_speed"])


def test_a_driver_by_hand_gives_a_data_set_of_the_lateral_half(tmp_path):
  time, own = drive(20.0)
  columns = {"commanded_steering": own["steering_command"], "speed": speed_of(own), "heading": own["pose_yaw"]}
  table, proposal = log(tmp_path, time, columns)
  assert not proposal.missing and table["vehicle"]["drive"] == "speed"
  assert any("the measured speed stands for it" in note for note in DataSet.load(tmp_path).warnings)


@pytest.mark.parametrize("size", [0.25, 2.15, 11.0])
def test_the_wheelbase_moves_where_the_angles_unit_is_known(tmp_path, size):
  time, own = drive(20.0)
  columns = {name: own[name] for name in ("motor_voltage", "steering_command", "motor_speed", "accel_y", "yaw_rate")}
  columns["speed"] = speed_of(own) * np.sqrt(size)
  columns["yaw_rate"] = own["yaw_rate"] / np.sqrt(size)
  del columns["motor_speed"]
  table, proposal = log(tmp_path, time, columns)
  assert "scale" not in table["channels"]["steering_command"]
  car = table["vehicle"]
  assert car["cg_to_front"] + car["cg_to_rear"] == pytest.approx(0.256 * size, rel=0.05)
  assert f"this log turns like a wheelbase of {0.256 * size:.1g}"[:-1] in proposal.text


def test_units_are_settled_before_the_steering(tmp_path):
  time, own = drive(20.0)
  columns = {
    "throttle": own["motor_voltage"] / 8.0,
    "steer": own["steering_command"],
    "velocity": 3.6 * speed_of(own),
    "x": own["pose_x"],
    "y": own["pose_y"],
    "gyro_z": own["yaw_rate"],
  }
  table, _ = log(tmp_path, time, columns)
  assert table["channels"]["velocity" if "velocity" in table["channels"] else "speed"]["scale"] == pytest.approx(
    1 / 3.6
  )
  assert "scale" not in table["channels"]["steering_command"]


def test_a_heading_in_degrees_that_jumps_is_scaled_and_unwrapped(tmp_path):
  time, own = drive(20.0)
  heading = np.mod(DEG * own["pose_yaw"] * 4.0, 360.0)
  table, _ = log(tmp_path, time, {"throttle": own["motor_voltage"] / 8.0, "speed": speed_of(own), "heading": heading})
  assert table["channels"]["pose_yaw"]["scale"] == pytest.approx(1.0 / DEG) and table["channels"]["pose_yaw"]["wrap"]


def test_the_unit_of_most_files_is_the_one_for_all(tmp_path):
  """One file of four in another unit than the rest: [channels] go by the rest, and the loader names the file."""
  names = ("one.csv", "two.csv", "three.csv", "four.csv")
  for seed, name in enumerate(names):
    time, own = drive(20.0, seed=seed)
    own["yaw_rate"] *= 1.0 / DEG if name == "three.csv" else 1.0
    write_csv(tmp_path / name, time, own)
  table = written(tmp_path, proposed(tmp_path, *names).text)
  assert table["channels"]["yaw_rate"].get("scale", 1.0) == pytest.approx(1.0)
  with pytest.raises(RecordingError, match="three.csv: yaw_rate .*, and 3 of the other 3 files agree"):
    DataSet.load(tmp_path)


def test_accelerations_in_g_are_scaled(tmp_path):
  time, own = drive(40.0)
  own |= {name: own[name] / 9.80665 for name in ("accel_x", "accel_y")}
  table, _ = log(tmp_path, time, own)
  assert table["channels"]["accel_y"]["scale"] == pytest.approx(9.80665)


def test_a_turn_that_no_angle_makes_gives_the_steering_no_scale(tmp_path):
  time, own = drive(20.0)
  crawl = {"speed": speed_of(own) / 50.0, "yaw_rate": own["yaw_rate"], "throttle": own["motor_voltage"] / 8.0}
  table, proposal = log(tmp_path, time, crawl | {"steer_cmd": own["steering_command"]})
  assert abs(table["channels"]["steering_command"].get("scale", 1.0)) < 10.0
  assert "no angle turns a car as much as this one turned at its speed" in proposal.text


@pytest.mark.parametrize("blank", [False, True])
def test_a_gear_gives_its_sign_to_a_speed_that_has_none(tmp_path, blank):
  time, own = drive(40.0)
  speed = speed_of(own) * np.where(time < 20.0, 1.0, -1.0)
  gear = np.where(speed < 0.0, -1.0, 1.0)
  size = np.where(np.arange(time.size) % 2, np.nan, np.abs(speed)) if blank else np.abs(speed)
  columns = {"velocity": size, "throttle": np.abs(own["motor_voltage"]) / 8.0, "gear": gear, "r": own["yaw_rate"]}
  table, _ = log(tmp_path, time, columns)
  assert table["channels"]["speed"]["gate"] == "gear"
  read = np.concatenate([run["speed"].value for run in DataSet.load(tmp_path).recordings])
  assert read.min() < -0.2 and read.max() > 0.2


def test_what_may_be_the_steering_and_what_is_no_clock_are_said(tmp_path):
  """Columns in another language, an angle in a message of turn rates, stamps of few digits."""
  time, own = drive(60.0)
  columns = {"throttle": own["motor_voltage"] / 8.0, "speed": speed_of(own), "gyro_z": own["yaw_rate"]}
  _, proposal = log(tmp_path, time, columns | {"Stuur": own["steering_command"], "rate_cmd.z": own["yaw_rate"] + 0.0})
  assert "the car turned as 'Stuur' says (" in proposal.text and "map it as steering_command" in proposal.text
  _, proposal = log(tmp_path, np.floor(time / 30.0), columns)
  assert "'time' says time by its name, and is no clock: it has 2 values in" in proposal.text
  _, proposal = log(tmp_path, np.where(np.arange(time.size) % 5 == 4, time - 0.09, time), columns)
  assert "is no clock: it goes back in" in proposal.text and "first row 5 of run.csv" in proposal.text
