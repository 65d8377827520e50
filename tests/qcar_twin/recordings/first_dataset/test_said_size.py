"""What a person says of the car's size goes into the draft; what is not said is estimated from it and marked."""

import dataclasses
import tomllib

import pytest

from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.vehicle.vehicle import QCAR, Vehicle
from tests.faults.falsities import wander
from tests.qcar_twin.recordings.drives import drive, write_csv


@pytest.fixture
def log(tmp_path):
  return read_table(write_csv(tmp_path / "run.csv", *drive()))


def test_what_was_said_is_in_the_draft(log):
  text = propose("car", [log], wheelbase=2.6, mass=1200.0).text
  table = tomllib.loads(text)
  car = Vehicle.from_dataset({key: value for key, value in table["vehicle"].items() if key != "std"})
  assert car.mass == 1200.0 and car.wheelbase == pytest.approx(2.6)
  assert "mass = 1200.0  # as said" in text and "mass" not in table["vehicle"]["std"]


def test_wheels_and_gear_that_were_said_are_no_guesses(log):
  text = propose("car", [log], wheelbase=0.33, wheel_radius=0.05, gear_ratio=0.085).text
  vehicle = tomllib.loads(text)["vehicle"]
  assert (vehicle["wheel_radius"], vehicle["gear_ratio"]) == (0.05, 0.085)
  assert not {"wheel_radius", "gear_ratio"} & vehicle["std"].keys()


def test_wheels_without_a_unit_go_by_the_radius_that_was_said(tmp_path):
  time, own = wander(4)
  columns = {"throttle": own["motor_voltage"] / 8.0, "steer": own["steering_command"], "gyro_z": own["yaw_rate"]}
  table = read_table(write_csv(tmp_path / "run.csv", time, columns | {"wheel_rl": own["speed"] / 0.04}))
  (question,) = [said for said in propose("car", [table], wheel_radius=0.04).questions if "wheel" in said]
  assert "for rad/s set scale = 0.04 on speed" in question


def test_a_wheels_turning_is_the_motors_by_the_gear_that_was_said(tmp_path):
  time, own = wander(4)
  columns = {"throttle": own["motor_voltage"] / 8.0, "steer": own["steering_command"], "gyro_z": own["yaw_rate"]}
  table = read_table(write_csv(tmp_path / "run.csv", time, columns | {"wheel_rad_s": own["speed"] / 0.04}))
  text = propose("car", [table], wheel_radius=0.04, gear_ratio=0.125).text
  assert tomllib.loads(text)["channels"]["motor_speed"]["scale"] == pytest.approx(8.0)
  assert "which a motor turns by gear_ratio = 0.125, as said" in text


def test_the_rest_is_estimated_and_says_so(log):
  text = propose("car", [log], wheelbase=2.6).text
  estimated = [line for line in text.splitlines() if "estimated from the wheelbase of 2.6 m that was said" in line]
  assert {line.partition(" = ")[0] for line in estimated} == {
    "mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius",
  }  # fmt: skip
  radius = tomllib.loads(text)["vehicle"]["wheel_radius"]
  assert radius == pytest.approx(QCAR.wheel_radius * 2.6 / QCAR.wheelbase, rel=1e-5)


def test_without_a_word_the_draft_is_as_before(log):
  car = tomllib.loads(propose("car", [log]).text)["vehicle"]
  assert car["mass"] == QCAR.mass and car["wheel_radius"] == QCAR.wheel_radius


@pytest.mark.parametrize("said", [{"wheelbase": 0.0}, {"mass": -1.0}, {"mass": float("nan")}])
def test_no_car_has_such_a_size(log, said):
  with pytest.raises(RecordingError, match=f"{next(iter(said))} must be a positive number"):
    propose("car", [log], **said)


@pytest.mark.parametrize(
  ("said", "cure"),
  [({"gear_ratio": 10.5}, "inverted: write 0.0952381"), ({"wheelbase": 0.26, "wheel_radius": 33.0}, "lengths in m")],
)
def test_another_convention_than_the_drafts_is_refused_with_its_cure(log, said, cure):
  with pytest.raises(RecordingError, match=f"what was said of the car:.*{cure}"):
    propose("car", [log], **said)


def test_millimetres_and_grams_are_said_before_anything_is_written(log):
  with pytest.raises(RecordingError, match="in mm. multiply all lengths by 0.001, and the mass, in g, by 0.001"):
    propose("car", [log], wheelbase=260.0, mass=2700.0)


def test_a_rate_that_was_said_is_the_clock_by_which_signs_and_units_are_settled(tmp_path):
  """A steering that counts to the right, a gyro in deg/s: both are told by motion, which needs a clock."""
  time, columns = wander(21)
  logged = {"throttle": columns["motor_voltage"] / 8.0, "speed": columns["speed"]}
  logged |= {"steer": -columns["steering_command"] / 0.5236, "gyro_z": columns["yaw_rate"]}
  write_csv(tmp_path / "run.csv", time, logged)
  table = read_table(tmp_path / "run.csv")
  without = dataclasses.replace(table, columns={name: own for name, own in table.columns.items() if name != "time"})
  draft = propose("car", [without], wheelbase=0.256)
  assert draft.missing == ("time",) and "say --rate" in draft.text
  told = propose("car", [without], rate=50.0, wheelbase=0.256)
  channels = tomllib.loads(told.text)["channels"]
  assert not told.missing and channels["time"] == {"rate": 50.0}
  assert channels["steering_command"]["scale"] < 0.0
  with pytest.raises(RecordingError, match="'time' is the clock; leave the rate out"):
    propose("car", [table], rate=50.0)
  with pytest.raises(RecordingError, match="rate must be a positive number"):
    propose("car", [without], rate=0.0)
