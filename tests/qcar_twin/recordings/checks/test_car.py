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


@pytest.mark.parametrize(
  ("wrong", "text"),
  [
    ({"layout": "reer"}, "layout must be one of all-wheel, rear, front, not 'reer'; did you mean 'rear'?"),
    ({"drive": "volts"}, "not 'volts'; did you mean 'voltage'?"),
    ({"layuot": "rear"}, "has unknown key 'layuot'; did you mean 'layout'?"),
    ({"supply_voltage": -3.0}, "supply_voltage must be a positive number, not -3.0"),
  ],
)
def test_words_and_keys_of_no_car_are_refused_by_file_and_nearest(wrong, text):
  with pytest.raises(ValueError) as caught:
    Vehicle.from_dataset(VEHICLE | wrong)
  assert str(caught.value).startswith("dataset.toml: [vehicle]") and str(caught.value).endswith(text)


def test_a_battery_of_a_thousand_volts_is_refused_with_its_unit(tmp_path):
  texts = ["[vehicle] supply_voltage is 7400 V, implausible above 100 V", "is it in mV? write 7.4"]
  refused(folder_with(tmp_path, *drive(), vehicle=VEHICLE | {"supply_voltage": 7400.0}), *texts)
  refused(folder_with(tmp_path, *drive(), vehicle=VEHICLE | {"supply_voltage": 1200.0}), "give the battery's volts")


def with_deviation(folder, line):
  path = folder / "dataset.toml"
  text = path.read_text(encoding="utf-8").replace("[[recording]]", f"[vehicle.std]\n{line}\n[[recording]]")
  path.write_text(text, encoding="utf-8")
  return folder


def test_a_deviation_larger_than_its_number_is_refused_with_its_unit(tmp_path):
  folder = with_deviation(folder_with(tmp_path, *drive()), "mass = 81")
  refused(folder, "dataset.toml: [vehicle.std] mass of 81 is larger than the 2.7", "is it in g? write 0.081")


def test_a_place_may_be_less_sure_than_it_is_far_from_the_centre(tmp_path):
  with_deviation(folder_with(tmp_path, *drive(), vehicle=VEHICLE | {"imu_x": 0.01}), "imu_x = 0.02")
  assert DataSet.load(tmp_path).vehicle_std["imu_x"] == 0.02


def test_a_number_of_no_car_is_said_once(caplog):
  for _ in range(2):
    Vehicle.from_dataset(VEHICLE | {"colour": 7.0})
  assert caplog.text.count("'colour' is not a number this twin knows and is left out") == 1


def test_a_data_sheet_of_a_motor_that_the_drive_does_not_ask_for_is_said(caplog):
  Vehicle.from_dataset(VEHICLE | {"drive": "speed", "motor_constant": 0.0027}, {"motor_constant": 4e-5})
  assert "'motor_constant' says nothing of a drive = \"speed\" and is left out" in caplog.text
