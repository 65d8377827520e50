"""Several sensors of a kind: the better one is taken and why is said, or a person is asked."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError
from tests.faults.falsities import wander
from tests.qcar_twin.recordings.first_dataset.test_propose import proposed, written
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log

WHEELS = ("wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr")
REAR = "mean of wheel_speed_rl and wheel_speed_rr"


def noisy(values, seed, sigma=0.01):
  return values + sigma * np.random.default_rng(seed).standard_normal(values.size)


def spiking(values, share, seed=9):
  out, random = values.copy(), np.random.default_rng(seed)
  out[random.random(values.size) < share] += 40.0
  return out


def line_of(text, channel):
  return next(line for line in text.splitlines() if line.startswith(f"{channel} ="))


@pytest.mark.parametrize("bad", [0, 2, 3])
@pytest.mark.parametrize("pose", [True, False])
def test_of_four_wheels_one_that_spikes_is_not_taken(tmp_path, bad, pose):
  time, own = wander(1)
  speeds = {name: noisy(own["speed"], k) for k, name in enumerate(WHEELS)}
  speeds[WHEELS[bad]] = spiking(speeds[WHEELS[bad]], 0.01)
  place = {name: own[name] for name in ("pose_x", "pose_y", "pose_yaw")} if pose else {}
  table, proposal = log(tmp_path, time, {"volts": own["motor_voltage"], **speeds, **place})
  taken = table["channels"]["speed"]["column"]
  assert taken in (*WHEELS, REAR) and WHEELS[bad] not in taken
  assert f"'{WHEELS[bad]}'" in line_of(proposal.text, "speed") or WHEELS[bad] in line_of(proposal.text, "speed")
  assert not proposal.questions


@pytest.mark.parametrize("stuck", [0, 1, 3])
def test_of_four_wheels_one_that_hangs_in_the_air_is_not_taken(tmp_path, stuck):
  time, own = wander(2)
  speeds = {name: noisy(own["speed"], k) for k, name in enumerate(WHEELS)}
  speeds[WHEELS[stuck]] = 0.02 * np.random.default_rng(5).standard_normal(time.size)
  table, _ = log(tmp_path, time, {"volts": own["motor_voltage"], **speeds, "gyro_z": own["yaw_rate"]})
  assert table["channels"]["speed"]["column"] != WHEELS[stuck]


@pytest.mark.parametrize("right", ["gyro_a", "gyro_b"])
@pytest.mark.parametrize("witness", ["heading", "steer"])
def test_the_gyro_that_other_sensors_agree_with_is_taken(tmp_path, right, witness):
  time, own = wander(3)
  other = {"gyro_a": "gyro_b", "gyro_b": "gyro_a"}[right]
  gyros = {right: own["yaw_rate"], other: np.roll(own["yaw_rate"], time.size // 3)}
  known = own["pose_yaw"] if witness == "heading" else own["steering_command"]
  columns = {"volts": own["motor_voltage"], "velocity": own["speed"], **dict(sorted(gyros.items())), witness: known}
  table, proposal = log(tmp_path, time, columns)
  assert table["channels"]["yaw_rate"]["column"] == right and not proposal.questions
  assert "other sensors agree with it" in line_of(proposal.text, "yaw_rate")


def test_two_gyros_that_nothing_witnesses_are_asked_and_the_answer_is_read(tmp_path):
  time, own = wander(4)
  columns = {"volts": own["motor_voltage"], "velocity": own["speed"]}
  columns |= {"gyro_a": own["yaw_rate"], "gyro_b": np.roll(own["yaw_rate"], time.size // 3)}
  table, proposal = log(tmp_path, time, columns)
  (question,) = proposal.questions
  assert question.startswith("yaw_rate is 'gyro_a' or 'gyro_b': they differ (correlation ")
  with pytest.raises(RecordingError, match="dataset.toml: not decided yet: yaw_rate is 'gyro_a' or 'gyro_b'"):
    DataSet.load(tmp_path)
  answered = "\n".join(line for line in proposal.text.splitlines() if not line.startswith("undecided"))
  written(tmp_path, answered.replace(f'"{table["channels"]["yaw_rate"]["column"]}"', '"gyro_b"'))
  read = np.concatenate([run["yaw_rate"].value for run in DataSet.load(tmp_path).recordings])
  assert np.isin(read, columns["gyro_b"]).all()


def test_two_gyros_that_agree_are_not_asked(tmp_path):
  time, own = wander(5)
  gyros = {name: noisy(own["yaw_rate"], k) for k, name in enumerate(("gyro_a", "gyro_b"))}
  _, proposal = log(tmp_path, time, {"volts": own["motor_voltage"], "velocity": own["speed"], **gyros})
  assert not proposal.questions and "of 2 alike (gyro_a, gyro_b)" in line_of(proposal.text, "yaw_rate")


@pytest.mark.parametrize("bad", ["slam", "vicon"])
def test_a_pose_comes_from_one_source_the_one_that_does_not_jump(tmp_path, bad):
  time, own = wander(6)
  columns = {"volts": own["motor_voltage"], "velocity": own["speed"]}
  for source in ("slam", "vicon"):
    for axis in ("x", "y", "yaw"):
      values = noisy(own[f"pose_{axis}"], len(source), 1e-3)
      columns[f"{source}_{axis}"] = spiking(values, 0.01) if source == bad and axis != "yaw" else values
  table, proposal = log(tmp_path, time, columns)
  good = {"slam": "vicon", "vicon": "slam"}[bad]
  taken = [table["channels"][f"pose_{axis}"]["column"] for axis in ("x", "y", "yaw")]
  assert taken == [f"{good}_{axis}" for axis in ("x", "y", "yaw")]
  assert "one of 2 poses, all from one source" in line_of(proposal.text, "pose_x")


def test_a_heading_comes_from_the_source_that_has_the_place(tmp_path):
  """Odometry's yaw says so by its name as well as the localiser's theta does, and is another, which drifts."""
  time, own = wander(6)
  columns = {"volts": own["motor_voltage"], "odom_v": own["speed"], "odom_yaw": 0.7 * own["pose_yaw"]}
  columns |= {"pf_x": own["pose_x"], "pf_y": own["pose_y"], "pf_theta": own["pose_yaw"]}
  table, proposal = log(tmp_path, time, columns)
  assert table["channels"]["pose_yaw"]["column"] == "pf_theta"
  assert "from one source with 'pf_x' (not 'odom_yaw')" in line_of(proposal.text, "pose_yaw")


def test_every_line_says_what_its_name_scored_and_the_next_one(tmp_path):
  time, own = wander(7)
  columns = {"volts": own["motor_voltage"], "velocity": own["speed"], "gyro_z": own["yaw_rate"]}
  _, proposal = log(tmp_path, time, columns | {"gyro_z_filtered": own["yaw_rate"]})
  assert "; name 2.50, next 'gyro_z_filtered' " in line_of(proposal.text, "yaw_rate")
  assert "no other" in line_of(proposal.text, "speed")


def test_a_file_with_a_question_that_is_no_list_is_refused_too(tmp_path):
  time, own = wander(8)
  log(tmp_path, time, {"volts": own["motor_voltage"], "velocity": own["speed"]})
  text = proposed(tmp_path, "run.csv").text
  written(tmp_path, text.replace("[vehicle]", 'undecided = "the gyro"\n[vehicle]', 1))
  with pytest.raises(RecordingError, match="not decided yet: the gyro"):
    DataSet.load(tmp_path)


def test_gyros_that_differ_by_noise_alone_are_not_asked_about_and_those_that_turn_otherwise_are(tmp_path):
  time, own = wander(9)
  columns = {"volts": own["motor_voltage"], "velocity": own["speed"], "gyro_a": own["yaw_rate"]}
  loud = noisy(own["yaw_rate"], 3, 0.5 * own["yaw_rate"].std())
  _, proposal = log(tmp_path, time, columns | {"gyro_b": loud})
  assert not proposal.questions and "they differ by noise alone" in line_of(proposal.text, "yaw_rate")
  slow = own["yaw_rate"] + 0.5 * own["yaw_rate"].std() * np.sin(0.3 * time)
  (tmp_path / "two").mkdir()
  assert log(tmp_path / "two", time, columns | {"gyro_b": slow})[1].questions


def test_of_alike_accelerometers_the_one_of_three_axes_is_the_sensors_own(tmp_path):
  """Controllers' messages repeat what they took from an IMU, smoothed say."""
  time, own = wander(10)
  random = np.random.default_rng(4)
  copy = {"THR.AccX": own["accel_x"], "volts": own["motor_voltage"], "Speed": own["speed"]}
  axes = (own["accel_x"], own["accel_y"], 9.81 * np.ones(time.size))
  imu = {f"IMU.Acc{axis}": v + 0.1 * random.standard_normal(v.size) for axis, v in zip("XYZ", axes, strict=True)}
  table, proposal = log(tmp_path, time, copy | imu)
  assert table["channels"]["accel_x"]["column"] == "IMU.AccX" and not proposal.questions
  assert "of three axes, the sensor's own" in line_of(proposal.text, "accel_x")


def test_a_heading_in_degrees_witnesses_as_one_in_radians_does(tmp_path):
  """No log is read before a heading's turns of 360 are settled, so nothing would be witnessed."""
  time, own = wander(3)
  columns = {"volts": own["motor_voltage"], "velocity": own["speed"]}
  columns |= {"gyro_a": np.roll(own["yaw_rate"], time.size // 3), "gyro_b": own["yaw_rate"]}
  table, proposal = log(tmp_path, time, columns | {"heading": np.mod(np.rad2deg(own["pose_yaw"]), 360.0)})
  assert table["channels"]["yaw_rate"]["column"] == "gyro_b" and not any("yaw_rate is" in q for q in proposal.questions)
  assert "other sensors agree with it" in line_of(proposal.text, "yaw_rate")


def test_both_commands_are_of_the_topic_whose_steering_the_car_obeyed(tmp_path):
  """A controller's wishes, which its topic's name says are commands, and what a person at the radio did instead."""
  time, own = wander(4)
  other = np.roll(own["steering_command"], 700)
  given = {"chassis.throttle": own["motor_voltage"] / 12.0, "chassis.steering": own["steering_command"]}
  wished = {"planner_command.throttle": np.roll(own["motor_voltage"], 700) / 12.0, "planner_command.steering": other}
  measured = {"velocity": own["speed"], "gyro_z": own["yaw_rate"]}
  table, proposal = log(tmp_path, time, {**wished, **given, **measured})
  assert {table["channels"][c]["column"].partition(".")[0] for c in ("motor_duty", "steering_command")} == {"chassis"}
  assert "beside the steering that the car obeyed" in line_of(proposal.text, "motor_duty")
  table, _ = log(tmp_path, time, {**wished, "servo.steering": own["steering_command"], **measured})
  assert table["channels"]["motor_duty"]["column"] == "planner_command.throttle"
