"""What was driven as a data set: it loads, says what acted and what was read, and grows drive by drive."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.onboard.drive import Terms, drive
from qcar_twin.onboard.likeness import compared, drives_of_script, likeness
from qcar_twin.onboard.plants import twin_plant, with_effects
from qcar_twin.onboard.recorder import add_drive, free_name, recording_of
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import RecordingError, Stream
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.onboard.rig import SCRIPTS, by_hand, drive_text, reduced


@pytest.fixture(scope="module")
def driven():
  """A drive that is long enough to be cut, and one that is not, twice."""
  terms = (("steps", ("1", "40")), ("threads", ("9",)), ("threads_run2", ("9",)))
  return [drive(SCRIPTS / f"{n.partition('_')[0]}.py", reduced(), Terms(words, n)) for n, words in terms]


def test_a_long_drive_is_cut_by_time_and_short_ones_take_turns(driven, tmp_path):
  long, short, other = (drive.car for drive in driven)
  added = add_drive(tmp_path / "set", recording_of(long, "steps"), reduced(), "steps.py")
  assert [(r.name, r.role) for r in added] == [
    ("steps_part1", "identify"),
    ("steps_part2", "validate"),
    ("steps_part3", "holdout"),
  ]
  manifest = tmp_path / "set" / "dataset.toml"
  mine = manifest.read_text(encoding="utf-8").replace('role = "validate"', 'role = "identify"')
  manifest.write_text(mine, encoding="utf-8")
  add_drive(tmp_path / "set", recording_of(short, "threads"), reduced(), "threads.py")
  assert free_name(tmp_path / "set", "threads", reduced()) == "threads_run2"
  assert free_name(None, "threads", reduced()) == "threads"
  add_drive(tmp_path / "set", recording_of(other, "threads_run2"), reduced(), "threads.py")
  dataset = DataSet.load(tmp_path / "set")
  roles = {r.name: r.role for r in dataset.recordings}
  assert roles["steps_part2"] == "identify" and len(roles) == 5  # what a person changed stays
  assert dataset["steps_part1"].duration == pytest.approx(24.0, abs=0.1)
  assert {"motor_voltage", "steering_command", "motor_speed", "yaw_rate", "pose_x"} <= set(
    dataset["steps_part1"].channels
  )


def test_commands_and_poses_stand_at_their_times(tmp_path):
  plant, commands = by_hand()
  text = """
    import time
    from pal.products.qcar import QCar
    car = QCar(readMode=1, frequency=100)
    for k in range(200):
      car.read()
      car.write(0.1 if k >= 100 else 0.0, 0.0)
  """
  recording = recording_of(drive_text(tmp_path, text, plant).car, "x")
  voltage = recording["motor_voltage"]
  assert voltage.value[99] == 0.0 and voltage.value[100] == pytest.approx(1.2, abs=1e-3)
  assert np.array(commands)[:, 0] == pytest.approx(voltage.value[: len(commands)])
  moving = recording["motor_speed"].time[np.flatnonzero(recording["motor_speed"].value > 10.0)[0]]
  assert moving == pytest.approx(1.01)  # told at 1.00 s, seen one period later
  fixes = recording["pose_x"]
  assert np.allclose(np.round(fixes.time * 100) % 10, 0)  # when measured, not when they arrived
  late = fixes.time > 1.05
  assert np.median(np.abs(fixes.value[late] - 1.2 * (fixes.time[late] - 1.0))) < 0.02


def test_another_car_needs_another_folder(driven, tmp_path):
  plant, _ = by_hand()
  recording = recording_of(driven[1].car, "threads")
  add_drive(tmp_path / "set", recording, reduced(), "threads.py")
  with pytest.raises(RecordingError, match="holds recordings of another car; name another folder with --record"):
    add_drive(tmp_path / "set", recording, plant, "threads.py")
  with pytest.raises(RecordingError, match="another car"):  # said before anything is driven
    free_name(tmp_path / "set", "threads", plant)
  (tmp_path / "file").touch()
  with pytest.raises(RecordingError, match="is a file; name a folder with --record"):
    free_name(tmp_path / "file", "threads", plant)


def test_a_drive_of_nothing_is_no_recording(tmp_path):
  with pytest.raises(RecordingError, match="too short to be a recording: drive longer"):
    recording_of(drive_text(tmp_path, "from pal.products.qcar import QCar\nQCar()\n").car, "x")


def test_two_drives_of_a_script_are_compared(driven, tmp_path):
  long, _, short = (recording_of(drive.car, "steps") for drive in driven)
  add_drive(tmp_path / "set", long, reduced(), "steps.py")
  same = likeness(long, [long.window(0.0, 20.0), long.window(25.0, 40.0)])
  assert same.seconds == pytest.approx(35.0) and max(*same.rms.values(), same.apart) < 1e-9
  moved = long.replace(streams={**long.streams, "pose_x": Stream(long["pose_x"].time, long["pose_x"].value + 0.3)})
  assert likeness(moved, [long]).apart == pytest.approx(0.3)
  wrong = moved["pose_x"].value.copy()
  wrong[100] += 5.0
  once = long.replace(streams={**long.streams, "pose_x": Stream(long["pose_x"].time, wrong)})
  assert likeness(once, [long]).apart == pytest.approx(0.3)  # a pose that is wrong once is the sensor's, not the car's
  add_drive(tmp_path / "set", dataclasses.replace(long, name="steps_run2").window(0.0, 20.0), reduced(), "steps.py")
  first, second = compared(long, tmp_path / "set", drives_of_script(tmp_path / "set", "steps")).splitlines()
  assert "set, steps: this drive differs over 40 s by motor speed" in first
  assert "set, steps_run2: this drive differs over 20 s by motor speed" in second
  assert likeness(short, [long]).rms["motor_speed"] > 50.0
  with pytest.raises(RecordingError, match="holds no drive of 'stepps'; did you mean 'steps'"):
    drives_of_script(tmp_path / "set", "stepps")


def test_a_car_with_another_effect_is_another_car(driven, tmp_path):
  add_drive(tmp_path / "set", recording_of(driven[1].car, "threads"), reduced(), "threads.py")
  twin = Twin(Vehicle.load(), threads=1)
  late = twin_plant(*with_effects(twin, twin.parameters.nominal, ("steering_delay=0.04",)), "reduced")
  with pytest.raises(
    RecordingError, match=r"this is reduced twin \w+, steering_delay = 0.04; one data set is of one car"
  ):
    free_name(tmp_path / "set", "threads", late)
  assert "steering_delay" not in DataSet.load(tmp_path / "set").source
