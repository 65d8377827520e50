"""Numbers of [vehicle] that cannot be one car's, and cars of every size that can."""

import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.recordings.drives import VEHICLE, drive, folder_with
from tests.qcar_twin.recordings.loading import refused

LENGTHS = ("cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius")
FULL_SIZE = {
  "mass": 1500.0, "yaw_inertia": 2500.0, "cg_to_front": 1.2, "cg_to_rear": 1.6, "track_width": 1.55, "cg_height": 0.55,
  "wheel_radius": 0.31, "gear_ratio": 0.11, "max_steering": 0.6,
}  # fmt: skip
SMALL = {
  "mass": 0.05, "yaw_inertia": 2.6e-5, "cg_to_front": 0.03, "cg_to_rear": 0.03, "track_width": 0.04, "cg_height": 0.012,
  "wheel_radius": 0.0095, "gear_ratio": 0.2, "max_steering": 0.45,
}  # fmt: skip
FIFTH = {
  "mass": 44.0, "yaw_inertia": 2.5, "cg_to_front": 0.22, "cg_to_rear": 0.33, "track_width": 0.52, "cg_height": 0.087,
  "wheel_radius": 0.11, "gear_ratio": 0.05, "max_steering": 0.5236,
}  # fmt: skip


@pytest.mark.parametrize("car", [FULL_SIZE, FIFTH, VEHICLE, SMALL], ids=["full size", "1:5", "1:10", "1:43"])
def test_cars_of_every_size_load(tmp_path, car):
  time, columns = drive()
  data = DataSet.load(
    folder_with(tmp_path, time, {k: columns[k] for k in ("motor_voltage",)} | {"speed": 0 * time + 0.5}, vehicle=car)
  )
  assert Vehicle.from_dataset(data.vehicle).wheelbase == pytest.approx(car["cg_to_front"] + car["cg_to_rear"])


@pytest.mark.parametrize(
  ("wrong", "texts"),
  [
    ({"mass": 2700.0}, ["mass of 2700 kg", "is it in g? write 2.7"]),
    ({k: 1000.0 * VEHICLE[k] for k in LENGTHS}, ["a wheelbase of 256 m", "is it in mm? multiply all lengths by 0.001"]),
    ({k: 100.0 * VEHICLE[k] for k in LENGTHS}, ["a wheelbase of 25.6 m", "is it in cm? multiply all lengths by 0.01"]),
    ({"gear_ratio": 10.4858}, ["gear_ratio", "it is inverted: write 0.0953671"]),
    ({"wheel_radius": 33.0}, ["wheel_radius of 33 m does not fit a wheelbase of 0.256 m"]),
    ({"yaw_inertia": 30.0}, ["yaw_inertia of 30 kg m^2 does not fit 2.7 kg"]),
  ],
)
def test_numbers_that_do_not_belong_together_are_refused_with_the_unit(tmp_path, wrong, texts):
  time, columns = drive()
  refused(folder_with(tmp_path, time, columns, vehicle=VEHICLE | wrong), "dataset.toml: [vehicle] ", *texts)


def test_a_wheelbase_is_not_left_out_but_refused_with_its_two_parts(tmp_path):
  time, columns = drive()
  halves = ["wheelbase is not read", "write its two parts, cg_to_front = 0.165 and cg_to_rear = 0.165"]
  refused(folder_with(tmp_path, time, columns, vehicle=VEHICLE | {"wheelbase": 0.33}), *halves)
  folder_with(tmp_path, time, columns)
  path = tmp_path / "dataset.toml"
  std = "[vehicle.std]\nwheelbase = 0.01\n[[recording]]"
  path.write_text(path.read_text(encoding="utf-8").replace("[[recording]]", std), encoding="utf-8")
  refused(tmp_path, "[vehicle.std] wheelbase is not read: write the deviations of cg_to_front and cg_to_rear")


def test_a_number_or_a_deviation_that_no_car_has_is_said_and_no_far_name_offered(caplog):
  Vehicle.from_dataset(VEHICLE | {"drive_ratio": 5.0}, {"friktion": 0.1, "gearing": 0.2})
  said = [record.getMessage() for record in caplog.records]
  assert [
    name for text in sorted(said) for name in ("drive_ratio", "friktion", "gearing") if f"'{name}' is not" in text
  ]
  assert len(said) == 3 and not any("did you mean" in text for text in said)
