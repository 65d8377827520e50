"""Logs that lack a sensor of speed, or anything that tells of turning: read as far as they go, and said."""

import numpy as np
import pytest

from calibration.log_check import check_log, heed
from qcar_twin.recordings.completed import completed, heading_or_course
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from tests.faults.falsities import FALSITIES, SIZES, wander
from tests.qcar_twin.recordings.drives import STD, VEHICLE, folder_with, write_csv, write_manifest
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log
from tests.qcar_twin.recordings.loading import refused

POSE = ("motor_voltage", "steering_command", "pose_x", "pose_y", "pose_yaw")


def only(columns, *names):
  return {name: columns[name] for name in names}


@pytest.mark.parametrize("every", [1, 2, 5])
@pytest.mark.parametrize("noise", [1e-4, 1e-3, 5e-3])
def test_speed_is_the_slope_of_the_pose_with_the_noise_that_is_said(tmp_path, every, noise):
  time, columns = wander(1)
  random = np.random.default_rng(0)
  rough = {name: columns[name] + noise * random.standard_normal(time.size) for name in ("pose_x", "pose_y")}
  kept = {name: values[::every] for name, values in (only(columns, *POSE) | rough).items()}
  data = DataSet.load(folder_with(tmp_path, time[::every], kept))
  (run,) = data.recordings
  error = run["speed"].value - np.interp(run["speed"].time, time, columns["speed"])
  (note,) = (w for w in data.warnings if "no sensor of speed was logged" in w)
  said = float(note.split("with a noise of ")[1].split()[0])
  assert run.derived == ("speed",)
  assert float(np.std(error)) == pytest.approx(said, rel=0.3) or float(np.std(error)) < 0.02
  assert abs(float(np.mean(error))) < 0.2 * said + 1e-3


def test_a_part_too_short_for_a_speed_is_named_by_its_seconds():
  """As a cut near a file's end leaves it: which part it is, and that leaving it out is the cure."""
  rows, poses = 24.75 + 0.01 * np.arange(20), 24.75 + 0.05 * np.arange(4)
  rest = Recording.from_columns("rest", rows, {"motor_voltage": np.ones(20), "steering_command": np.zeros(20)})
  rest = rest.replace(streams=dict(rest.streams) | {name: Stream(poses, poses) for name in ("pose_x", "pose_y")})
  with pytest.raises(RecordingError, match=r"run.csv: from 24.75 s to 24.94 s the pose .* leave out the \[\[recording"):
    completed([rest], VEHICLE, "run.csv")


def test_reverse_has_its_sign_where_there_is_a_heading_and_its_size_where_not(tmp_path):
  time, columns = wander(2)
  back = only(columns, *POSE) | {"pose_x": -columns["pose_x"], "pose_y": -columns["pose_y"]}
  back["motor_voltage"] = -columns["motor_voltage"]
  (run,) = DataSet.load(folder_with(tmp_path, time, back)).recordings
  assert np.median(run["speed"].value) < -0.5
  del back["pose_yaw"]
  data = DataSet.load(folder_with(tmp_path, time, back))
  assert np.median(data.recordings[0]["speed"].value) > 0.5
  assert any("its size, as there is no heading to tell backwards" in note for note in data.warnings)


def test_a_course_turns_as_the_car_does_forwards_and_backwards():
  time, columns = wander(2)
  run = Recording.from_columns("run", time, only(columns, "pose_x", "pose_y"))
  back = Recording.from_columns("back", time, {name: -columns[name] for name in ("pose_x", "pose_y")})
  for recording in (run, back):
    course = heading_or_course(recording)
    turned = course.value - np.interp(course.time, time, columns["pose_yaw"])
    assert np.std(turned - np.median(turned)) < 0.05
  assert heading_or_course(Recording.from_columns("none", time, only(columns, "speed"))) is None


def test_a_steering_with_the_other_sign_is_drafted_right_by_the_place_alone(tmp_path):
  time, columns = wander(6)
  flipped = only(columns, "motor_voltage", "pose_x", "pose_y") | {"steering_command": -columns["steering_command"]}
  table, _ = log(tmp_path, time, flipped)
  assert table["channels"]["steering_command"]["scale"] == -1.0


def test_what_was_derived_is_neither_written_nor_a_witness(tmp_path):
  time, columns = wander(3)
  (run,) = DataSet.load(folder_with(tmp_path, time, only(columns, *POSE))).recordings
  write_dataset(tmp_path / "again", "again", VEHICLE, STD, [run])
  assert "speed" not in (tmp_path / "again" / "run.csv").read_text().partition("\n")[0]
  (again,) = DataSet.load(tmp_path / "again").recordings
  assert (again["speed"].value == run["speed"].value).all()
  check = check_log(DataSet("lab", (run,), VEHICLE, STD))
  assert not check.of("spoils")
  driving = next(c for c in check.comparisons if c.motion.name == "driving")
  assert driving.motion.compared == ("pose_yaw",)


@pytest.mark.parametrize("size", SIZES.values())
@pytest.mark.parametrize(
  "name",
  ["pose_yaw in degrees", "pose_yaw a quarter turn off", "pose_yaw turned round", "pose_y with the other sign",
   "steering_command with the other sign", "pose in mm"],
)  # fmt: skip
def test_a_false_pose_or_steering_of_a_log_without_other_sensors_is_refused(name, size):
  time, columns = wander(4, size)
  falsity = next(f for f in FALSITIES if f.name == name)
  time, columns = falsity.apply(time, only(columns, *POSE))
  powers = {"mass": 3, "yaw_inertia": 5, "gear_ratio": 0, "max_steering": 0}
  car = {key: value * size ** powers.get(key, 1) for key, value in VEHICLE.items() if not isinstance(value, str)}
  (run,), _ = completed([Recording.from_columns("run", time, columns)], car, "run.csv")
  assert check_log(DataSet("lab", (run,), car)).of("spoils")


def test_a_log_of_wheel_speed_alone_gives_the_drive_and_says_that_turning_cannot_be_judged(tmp_path):
  time, columns = wander(5)
  data = DataSet.load(folder_with(tmp_path, time, only(columns, "motor_voltage", "speed")))
  text, clock, alone = heed(data)
  assert "unit, sign and age of speed cannot be judged" in alone and "the clock cannot be judged" in clock
  assert "the drive can be judged; turning, steering and tyres cannot be judged" in text
  assert not any("cannot be judged" in t for t in heed(DataSet.load(folder_with(tmp_path, time, columns))))


def test_a_motion_captures_log_is_drafted(tmp_path):
  time, columns = wander(6)
  names = ("volts", "steer", "vicon_x", "vicon_y", "vicon_yaw")
  table, proposal = log(tmp_path, time, dict(zip(names, only(columns, *POSE).values(), strict=True)))
  assert not proposal.missing and "speed" not in table["channels"]
  read = DataSet.load(tmp_path).recordings
  assert all("speed" in run.channels for run in read) and len(read) == 3


def test_neither_speed_nor_pose_is_refused_with_what_would_do(tmp_path):
  time, columns = wander(7)
  write_csv(tmp_path / "run.csv", time, only(columns, "motor_voltage", "steering_command", "yaw_rate"))
  refused(write_manifest(tmp_path), "neither 'motor_speed' nor 'speed' is there, nor a pose that gives it")
