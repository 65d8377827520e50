"""Logs as other people's tools call and count things: engines, receivers, encoders, messages, pedals, parts."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.columns import Columns, guess_columns
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import Table, read_table
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.recordings.drives import VEHICLE, drive, write_csv
from tests.qcar_twin.recordings.first_dataset.test_propose import DEG
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log, speed_of


def driven():
  """Time and what was driven for 60 s, with the speed in m/s and a throttle."""
  time, own = drive(60.0)
  return time, own | {"speed": speed_of(own), "throttle": own["motor_voltage"] / 8.0}


def columns_of(table):
  return {channel: entry["column"] for channel, entry in table["channels"].items()}


def test_latitude_and_longitude_are_a_place_and_the_heading_beside_them_a_compass(tmp_path):
  time, own = driven()
  north = 6371000.0 * np.pi / 180.0  # m a degree
  columns = {
    "throttle": own["throttle"],
    "speed": own["speed"],
    "steering [deg]": DEG * own["steering_command"],
    "lat": 48.0 + own["pose_y"] / north,
    "lon": 9.0 + own["pose_x"] / north / np.cos(np.deg2rad(48.0)),
    "heading [deg]": np.mod(90.0 - DEG * own["pose_yaw"], 360.0),
  }
  columns = {name: np.round(values, 8) for name, values in columns.items()}
  table, proposal = log(tmp_path, time, columns)
  assert not proposal.questions and columns_of(table)["pose_x"] == "gps.east"
  run = DataSet.load(tmp_path).recordings[0]
  for channel, tolerance in (("pose_x", 0.02), ("pose_y", 0.02), ("pose_yaw", 0.01), ("steering_command", 0.01)):
    value, true = run[channel].value, own[channel][: len(run[channel])]
    apart = value - true - (value[0] - true[0] if channel.startswith("pose") else 0.0)
    assert np.abs(apart).max() < tolerance * max(1.0, np.abs(true).max()), channel


@pytest.mark.parametrize("engine", ["CARLA", "Unity"])
def test_an_engine_that_counts_to_the_right_is_asked_about_and_the_cure_is_right(tmp_path, engine):
  time, own = driven()
  names = {"location.x": "pose_x", "location.y": "pose_y", "rotation.yaw": "pose_yaw"}
  if engine == "Unity":
    names = {"position.z": "pose_x", "position.x": "pose_y", "eulerAngles.y": "pose_yaw"}
  columns = {name: own[channel] * (1.0 if channel == "pose_x" else -1.0) for name, channel in names.items()}
  columns[next(name for name in names if names[name] == "pose_yaw")] *= DEG
  columns |= {"throttle": own["throttle"], "speed": own["speed"], "steer": -own["steering_command"]}
  if engine == "Unity":
    columns |= {"position.y": 0.05 + 1e-4 * np.sin(time), "angularVelocity.y": -own["yaw_rate"]}
  table, proposal = log(tmp_path, time, columns)
  (question,) = proposal.questions
  assert f"called as {engine}'s, which counts to the right" in question
  sided = question.split("scale and offset of ")[1].split(" by -1")[0].split(", ")
  assert "steering_command" in sided and "pose_yaw" in sided and columns_of(table)["pose_yaw"] in columns
  with pytest.raises(RecordingError, match="correct .channels. by it, or leave it, and delete it from undecided"):
    DataSet.load(tmp_path)
  table = "\n".join(_mirrored(line, sided) for line in proposal.text.splitlines() if not line.startswith("undecided"))
  (tmp_path / "dataset.toml").write_text(table, encoding="utf-8")
  run = DataSet.load(tmp_path).recordings[0]
  for channel in sided:
    true = own[channel][: len(run[channel])]
    assert np.corrcoef(run[channel].value, true)[0, 1] > 0.99, channel


def _mirrored(line: str, sided: list[str]) -> str:
  """A line of a draft with its scale times -1."""
  channel = line.partition(" = ")[0]
  if channel not in sided:
    return line
  if "scale = " in line:
    return line.replace("scale = ", "scale = -", 1)
  return line.replace(" }", ", scale = -1.0 }", 1)


def test_a_compass_alone_is_asked_about(tmp_path):
  time, own = driven()
  columns = {"throttle": own["throttle"], "speed": own["speed"], "steering": own["steering_command"]}
  columns["heading"] = np.mod(-DEG * own["pose_yaw"], 360.0)
  _, proposal = log(tmp_path, time, columns)
  assert "may count as a compass does, clockwise" in proposal.questions[0]
  columns["gyro_z"] = own["yaw_rate"]
  (tmp_path / "two").mkdir()
  assert not log(tmp_path / "two", time, columns)[1].questions


def test_electrical_revolutions_are_asked_about_and_counts_are_no_speed(tmp_path):
  time, own = driven()
  columns = {"throttle": own["throttle"], "servo": own["steering_command"], "gyro_z": own["yaw_rate"]}
  columns |= {"erpm": own["motor_speed"] * 60.0 / np.pi, "encoder_ticks": np.cumsum(own["motor_speed"]) % 65536}
  table, proposal = log(tmp_path, time, columns)
  assert table["channels"]["motor_speed"]["scale"] == pytest.approx(np.pi / 60.0)
  assert "counts electrical revolutions" in proposal.questions[0]
  assert "'encoder_ticks' seems to count an encoder's steps, and a speed is their change" in proposal.text


def test_counts_since_the_last_row_and_pulses_per_second_are_told_from_those_that_add_up(tmp_path):
  time, own = driven()
  counts = np.round(own["motor_speed"] * np.sin(0.3 * time))
  columns = {"throttle": own["throttle"], "servo": own["steering_command"], "gyro_z": own["yaw_rate"]}
  text = log(tmp_path, time, columns | {"enc_left": counts, "hall pulses/s": np.abs(counts)})[1].text
  assert "'enc_left' seems to count an encoder's steps from row to row" in text
  assert "'hall pulses/s' counts an encoder's steps per second" in text


def test_the_speed_of_a_vesc_counts_electrical_revolutions(tmp_path):
  time, own = driven()
  columns = {"/drive.drive.speed": own["speed"], "/drive.drive.steering_angle": own["steering_command"]}
  columns |= {
    "/sensors/core.state.speed": own["motor_speed"] * 60.0 / np.pi,
    "/imu.angular_velocity.z": own["yaw_rate"],
  }
  table, proposal = log(tmp_path, time, columns)
  assert table["channels"]["motor_speed"]["column"] == "/sensors/core.state.speed"
  assert table["channels"]["motor_speed"]["scale"] == pytest.approx(np.pi / 60.0)
  assert "speed" not in table["channels"] and "counts electrical revolutions" in proposal.questions[0]


def test_a_vesc_driven_by_current_with_odometry_whose_turning_is_the_commanded_one(tmp_path):
  time, own = driven()
  columns = {"/commands/motor/current.data": 20.0 * own["throttle"], "/odom.twist.twist.linear.x": own["speed"]}
  columns |= {"/commands/servo/position.data": own["steering_command"], "/imu.angular_velocity.z": own["yaw_rate"]}
  columns["/odom.twist.twist.angular.z"] = 1.4 * own["speed"] * np.tan(own["steering_command"]) / 0.256
  columns |= {"/mocap.pose.position.x": own["pose_x"], "/mocap.pose.position.y": own["pose_y"]}
  table, _ = log(tmp_path, time, columns | {"/mocap.pose.yaw": own["pose_yaw"]})
  taken = columns_of(table)
  assert (taken["motor_current"], taken["yaw_rate"]) == ("/commands/motor/current.data", "/imu.angular_velocity.z")


def test_a_stamp_that_two_messages_share_says_nothing_of_held_values(tmp_path):
  time, own = driven()
  commands = {name: np.repeat(own[name], 2) for name in ("throttle", "steering_command")}
  sensors = {name: np.repeat(own[name], 2) for name in ("motor_speed", "yaw_rate")}
  for columns, first in ((commands, 1), (sensors, 0)):
    for values in columns.values():
      values[first::2] = np.nan
  stamps = np.repeat(time, 2)
  stamps[1::2] += 0.004
  stamps[41] = stamps[40]
  table, _ = log(tmp_path, stamps, commands | sensors)
  assert not any(entry.get("hold") for entry in table["channels"].values())


def test_names_of_simulators_messages_and_pedals(tmp_path):
  time, own = driven()
  columns = {
    "poses_x": own["pose_x"],
    "poses_y": own["pose_y"],
    "linear_vels_x": own["speed"],
    "ang_vels_z": own["yaw_rate"],
    "drive.speed": np.repeat(own["speed"][::10], 10),
    "drive.steering_angle": own["steering_command"],
    "cmd_vel.angular.z": own["yaw_rate"] + 0.1 * np.sin(3.0 * time),
  }
  table, proposal = log(tmp_path, time, columns)
  taken = columns_of(table)
  assert not proposal.questions and (taken["pose_x"], taken["speed"]) == ("poses_x", "linear_vels_x")
  assert (taken["speed_command"], taken["yaw_rate"]) == ("drive.speed", "ang_vels_z")
  (tmp_path / "two").mkdir()
  pedal = {"AccelPedalPos[%]": 100.0 * own["throttle"], "Speed[m/s]": own["speed"]}
  assert columns_of(log(tmp_path / "two", time, pedal)[0])["motor_duty"] == "AccelPedalPos[%]"


def test_a_share_of_lock_that_hardly_turns_a_small_car_is_of_a_large_one(tmp_path):
  time, own = driven()
  size = 10.0
  columns = {"throttle": own["throttle"], "steering": own["steering_command"] / 0.5236 + 0.0}
  columns |= {"speed": own["speed"], "yaw_rate": own["yaw_rate"] / size}
  columns["steering"] = columns["steering"] * 1.0 / np.abs(columns["steering"]).max()
  table, proposal = log(tmp_path, time, columns)
  car, scale = table["vehicle"], table["channels"]["steering_command"]["scale"]
  assert scale == pytest.approx(0.5236) and car["cg_to_front"] + car["cg_to_rear"] > 2.0
  assert "it would hardly steer any car" in proposal.text
  read = read_table(tmp_path / "run.csv")
  assert "it would hardly steer" not in propose("car", [read], wheelbase=0.256).text


def test_an_angle_beyond_any_lock_is_of_a_small_car(tmp_path):
  """A 1:28 car's log: at a 1:10 car's wheelbase its angle would be one of 60 degrees."""
  time, own = driven()
  columns = {"throttle": own["throttle"], "speed": own["speed"], "steer": own["steering_command"]}
  table, proposal = log(tmp_path, time, columns | {"yaw_rate": own["yaw_rate"] / 0.38})
  car, steering = table["vehicle"], table["channels"]["steering_command"]
  assert "scale" not in steering and "it would steer no car" in proposal.text
  assert car["cg_to_front"] + car["cg_to_rear"] == pytest.approx(0.38 * 0.256, rel=0.15)


def test_the_elements_of_a_vector_by_number_are_its_axes(tmp_path):
  """As Python's libraries for the QCar return them, each in a column of its own."""
  time, own = driven()
  noise = np.random.default_rng(6).standard_normal((4, time.size))
  imu = {"gyroscope_0": 0.01 * noise[0], "gyroscope_1": 0.01 * noise[1], "gyroscope_2": own["yaw_rate"]}
  imu |= {"accelerometer_0": own["accel_x"], "accelerometer_1": own["accel_y"], "accelerometer_2": 9.81 + noise[2]}
  columns = {"throttle": own["throttle"], "speed": own["speed"], "steering": own["steering_command"], **imu}
  taken = columns_of(log(tmp_path, time, columns)[0])
  assert [taken[name] for name in ("accel_x", "accel_y", "yaw_rate")] == [
    "accelerometer[0]", "accelerometer[1]", "gyroscope[2]"
  ]  # fmt: skip
  run = DataSet.load(tmp_path).recordings[0]
  assert run["accel_y"].value == pytest.approx(own["accel_y"][: len(run["accel_y"])])


def test_a_counter_of_laps_counts_no_steps(tmp_path):
  time, own = driven()
  columns = {"throttle": own["throttle"], "speed": own["speed"], "steering": own["steering_command"]}
  columns |= {
    "lap_count": np.floor(time / 20.0),
    "enc": np.mod(np.floor(3e4 * np.cumsum(own["speed"]) / 100.0), 65536.0),
  }
  _, proposal = log(tmp_path, time, columns)
  assert "'enc' seems to count" in proposal.text and "'lap_count' seems" not in proposal.text


def test_parts_of_one_drive_are_to_be_joined_and_clocks_without_a_common_time_said(tmp_path):
  time, own = driven()
  parts = {"imu.csv": (time, {"gx": own["yaw_rate"]}), "drive.csv": (time + 1.7e9, {"control[0]": own["throttle"]})}
  tables = [read_table(write_csv(tmp_path / name, stamp, columns)) for name, (stamp, columns) in parts.items()]
  with pytest.raises(RecordingError, match=r"imu.csv, drive.csv share no column but a clock.*pandas.merge.*no time in"):
    propose("car", tables)


def test_stamps_of_too_few_digits_are_to_have_a_rate_that_works(tmp_path):
  time, own = driven()
  columns = {"throttle": own["throttle"], "speed": own["speed"], "gyro_z": own["yaw_rate"]}
  _, proposal = log(tmp_path, np.floor(time * 50.0) / 50.0, columns)
  with pytest.raises(RecordingError, match=r"set time = \{ rate = 100"):
    DataSet.load(tmp_path)
  lines = ["time = { rate = 100 }" if line.startswith("time =") else line for line in proposal.text.splitlines()]
  (tmp_path / "dataset.toml").write_text("\n".join(lines), encoding="utf-8")
  assert DataSet.load(tmp_path).recordings[0]["speed"].time[:500] == pytest.approx(time[:500])


def test_parts_of_a_quaternion_and_of_a_stamp_are_no_channels(tmp_path):
  """The heading of a bag is its quaternion's yaw, and the clock no whole seconds."""
  time, own = driven()
  whole, yaw = np.floor(1.6e9 + time), own["pose_yaw"]
  columns = {
    "header.stamp.secs": whole,
    "header.stamp.nsecs": np.round(1e9 * (1.6e9 + time - whole)),
    "throttle": own["throttle"],
    "steering [rad]": own["steering_command"],
    "speed [m/s]": own["speed"],
    "pose.position.x": own["pose_x"],
    "pose.position.y": own["pose_y"],
    "pose.orientation.x": 0.01 * np.sin(time),
    "pose.orientation.y": 0.01 * np.cos(time),
    "pose.orientation.z": np.sin(0.5 * yaw),
    "pose.orientation.w": np.cos(0.5 * yaw),
  }
  table, _ = log(tmp_path, 1.6e9 + time, columns)
  named = columns_of(table)
  assert named["pose_yaw"] == "pose.orientation.yaw" and named["time"] in ("time", "header.stamp")


def test_a_speed_that_only_rises_is_no_clock():
  time, own = driven()
  rising = np.cumsum(np.abs(own["speed"])) ** 2
  guessed = lambda **columns: guess_columns(Columns([Table("run.csv", columns, {})]))
  assert "time" not in guessed(a=own["throttle"], b=rising)
  assert guessed(a=own["throttle"], b=rising, c=1.6e9 + time)["time"].column == "c"


def test_a_measured_speed_tells_the_gear_ratio(tmp_path):
  time, own = driven()
  motor = {"motor_rpm": own["motor_speed"] * 60.0 / (2.0 * np.pi), "steering_angle_rad": own["steering_command"]}
  halved = {"speed [m/s]": 0.5 * own["speed"], "gyro z [rad/s]": 0.5 * own["yaw_rate"], "throttle": own["throttle"]}
  table, _ = log(tmp_path, time, motor | halved)
  vehicle = table["vehicle"]
  travel = VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"]
  assert vehicle["gear_ratio"] * vehicle["wheel_radius"] == pytest.approx(0.5 * travel, rel=0.01)
  assert vehicle["cg_to_front"] + vehicle["cg_to_rear"] == pytest.approx(0.256, rel=0.1), "turned by the right speed"


def test_an_odometer_with_a_unit_counts_no_steps(tmp_path):
  time, own = driven()
  counts = {"Odometer[km]": np.cumsum(np.abs(own["speed"])), "ticks": np.cumsum(np.abs(own["speed"]))}
  _, proposal = log(tmp_path, time, {"throttle": own["throttle"], "speed": own["speed"]} | counts)
  said = [line for line in proposal.channels if "encoder's steps" in line]
  assert len(said) == 1 and "'ticks'" in said[0]


def test_a_column_that_occurs_twice_is_refused_unless_both_are_one(tmp_path):
  """The second of two steering columns was used by nothing, and the log passed without any steering."""
  time, own = driven()
  write_csv(tmp_path / "run.csv", time, {"throttle": own["throttle"], "steering": own["steering_command"],
                                         "other": 0.5 * own["steering_command"], "speed": own["speed"]})  # fmt: skip
  text = (tmp_path / "run.csv").read_text(encoding="utf-8")
  (tmp_path / "run.csv").write_text(text.replace("other", "steering", 1), encoding="utf-8")
  with pytest.raises(RecordingError, match=r"run.csv: column 'steering' occurs more than once; rename or remove"):
    Columns([read_table(tmp_path / "run.csv", "run.csv")])
  rows = [line.split(",") for line in text.splitlines()]
  place = rows[0].index("other")
  same = "\n".join(",".join([*row[:place], row[2], *row[place + 1 :]]) for row in rows)
  (tmp_path / "run.csv").write_text(same, encoding="utf-8")
  table = read_table(tmp_path / "run.csv", "run.csv")
  assert rows[0][2] == "steering" and not table.ambiguous
  assert guess_columns(Columns([table]))["steering_command"].column == "steering"


def test_an_engine_that_counts_y_upwards_is_asked_about_and_its_accelerometer_goes_with_its_gyro(tmp_path):
  """Donkey's simulator: z forwards, x to the right, y up, for places, accelerometer and gyro alike."""
  time, own = driven()
  flat = 0.0 * time + 1e-4 * np.sin(time)
  columns = {
    "throttle": own["throttle"],
    "steering_angle": -own["steering_command"],
    "speed": own["speed"],
    "pos_x": -own["pose_y"],
    "pos_y": 0.6 + flat,
    "pos_z": own["pose_x"],
    "accel_x": -own["accel_y"],
    "accel_y": flat,
    "accel_z": own["accel_x"],
    "gyro_x": flat,
    "gyro_y": -own["yaw_rate"],
    "gyro_z": 0.0 * time,
  }
  table, proposal = log(tmp_path, time, columns)
  named = columns_of(table)
  assert (named["accel_x"], named["accel_y"], named["yaw_rate"]) == ("accel_z", "accel_x", "gyro_y")
  (question,) = proposal.questions
  assert (
    "'pos_y' points up" in question and "scale and offset of steering_command, accel_y, yaw_rate, pose_y" in question
  )


def test_a_heading_that_was_put_on_askew_is_turned(tmp_path):
  time, own = driven()
  columns = {"throttle": own["throttle"], "speed": own["speed"], "steering": own["steering_command"]}
  place = {"x": own["pose_x"], "y": own["pose_y"], "yaw": own["pose_yaw"] + 0.5}
  table, _ = log(tmp_path, time, columns | place)
  assert table["channels"]["pose_yaw"]["offset"] == pytest.approx(-0.5, abs=0.05)
