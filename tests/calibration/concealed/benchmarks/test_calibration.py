"""The page of calibrations: kept results are read, tables say what the documents hold."""

import json
import math

import numpy as np
import pytest

from calibration.concealed.benchmarks.calibration import (
  Record,
  about,
  by_manoeuvre,
  errors_table,
  judge,
  manoeuvre_table,
  match,
  page,
  runs_table,
  steps_table,
  windows_table,
)
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording

NUMBERS = {
  "name": "car", "mass": 2.7, "yaw_inertia": 0.03, "cg_to_front": 0.128, "cg_to_rear": 0.128, "track_width": 0.17,
  "cg_height": 0.045, "wheel_radius": 0.033, "gear_ratio": 0.0953668, "max_steering": 0.5236,
}  # fmt: skip


def drive(name, role, manoeuvre, speed):
  time = np.arange(0.0, 5.0, 0.01)
  columns = {"motor_voltage": np.full(len(time), 1.0), "speed": speed * (1.0 - np.exp(-time))}
  return Recording.from_columns(name, time, columns, role=role, manoeuvre=manoeuvre)


@pytest.fixture
def dataset():
  made = [
    drive("fast", "validate", "voltage_step", 1.0),
    drive("held", "validate", "voltage_step", 0.0),
    drive("ramp", "validate", "ramp", 0.5),
    drive("fitted", "identify", "voltage_step", 0.8),
  ]
  return DataSet("car", tuple(made), NUMBERS, {})


def scores(**by_model):
  """speed alone; model=(RMSE, NRMSE, samples)."""
  return {m: {"speed": {"rmse": r, "nrmse": n, "samples": k, "unit": "m/s"}} for m, (r, n, k) in by_model.items()}


def validation(bicycle=True):
  def of(rmse, samples, nrmse=0.1):
    models = {"twin": (rmse, nrmse, samples)} | ({"bicycle": (2 * rmse, nrmse, samples)} if bicycle else {})
    return {w: scores(**models) for w in ("0.5 s", "2 s", "free run")}

  return {
    "roles": ["validate"],
    "bicycle": {"origin": "identified from steps"} if bicycle else None,
    "missing": "" if bicycle else "no steps",
    "windows": of(0.02, 30),
    "recordings": {"fast": of(0.03, 10), "held": of(0.0, 30, None), "ramp": of(0.01, 20)},
  }


def calibration(command_shift=0):
  error = {"before": 0.5, "after": 0.02, "noise_floor": None, "unit": "m/s"}
  return {
    "errors": {"identify": {"speed": error}, "validate": {"speed": error | {"after": 0.03}}},
    "notes": ["something was left at its prior"],
    "command_shift": command_shift,
  }


def steps(longitudinal, lateral):
  both = lambda x: {"identify": x, "validate": x}
  return {"steps_rmse_percent": {"longitudinal": both(longitudinal), "lateral": both(lateral), "yaw_rate": both(0.5)}}


@pytest.mark.parametrize(
  ("document", "said"),
  [
    (steps(0.9, 1.9), "reached"),
    (steps(1.1, 1.9), "missed: longitudinal |"),
    (steps(0.9, 2.1), "missed: lateral |"),
    (steps(0.9, math.nan), "missed: lateral |"),  # no step steers show nothing
  ],
)
def test_a_data_set_reaches_the_aims_or_is_said_to_miss_them(document, said):
  row = steps_table({"car": document}).splitlines()[-1]
  assert row.startswith("| car |") and said in row


def test_what_was_made_before_is_read_and_not_made_again(dataset, tmp_path, monkeypatch):
  write_dataset(tmp_path / "car", "car", NUMBERS, {}, dataset.recordings)
  for part, document in (("calibration", calibration()), ("cross_validation", validation())):
    (tmp_path / "out" / part).mkdir(parents=True)
    (tmp_path / "out" / part / f"{part}.json").write_text(json.dumps(document), encoding="utf-8")
  monkeypatch.setattr("calibration.concealed.benchmarks.calibration.calibrate", None)
  record = judge(tmp_path / "car", tmp_path / "out")
  assert record.calibration == calibration() and record.cross_validation == validation()
  assert match(tmp_path / "car", tmp_path / "out" / "calibration") == calibration()
  with pytest.raises(TypeError):  # what is not there would be made
    match(tmp_path / "car", tmp_path / "elsewhere")


def test_errors_of_a_manoeuvre_count_every_value_once(dataset):
  errors = by_manoeuvre(Record(dataset, calibration(), validation()))
  assert errors["ramp"]["speed"] == {"twin": 0.01, "bicycle": 0.02}
  assert errors["voltage_step"]["speed"]["twin"] == pytest.approx(math.sqrt(0.03**2 * 10 / 40))
  assert manoeuvre_table(errors).splitlines()[2:] == ["| voltage_step | 0.015 / 0.03 |", "| ramp | 0.01 / 0.02 |"]


def test_recordings_in_which_the_car_stands_are_marked_and_stay_out_of_the_mean(dataset):
  rows = runs_table(Record(dataset, calibration(), validation())).splitlines()
  assert rows[2:5] == [
    "| fast | yes | 0.03 m/s | 0.06 m/s |",
    "| held | no | 0 m/s | 0 m/s |",
    "| ramp | yes | 0.01 m/s | 0.02 m/s |",
  ]
  assert rows[5] == "| mean of those that move |  | 0.02 | 0.04 |"


def test_without_a_bicycle_the_twin_stands_alone(dataset):
  record = Record(dataset, calibration(), validation(bicycle=False))
  assert (
    windows_table(record.cross_validation).splitlines()[-1]
    == "| speed [m/s] | 0.02 (0.10) | 0.02 (0.10) | 0.02 (0.10) |"
  )
  assert "Bicycle: none (no steps)." in about(record)
  assert runs_table(record).splitlines()[0] == "| recording | moves | twin |"


def test_a_data_set_without_judges_says_that_the_fitted_was_predicted(dataset):
  predicted = validation() | {"roles": ["identify"]}
  assert "none to judge by" in about(Record(dataset, calibration(), predicted))
  assert "none to judge by" not in about(Record(dataset, calibration(), validation()))


def test_errors_stand_beside_the_sensor_noise_and_an_unknown_one_is_blank():
  assert errors_table(calibration()).splitlines()[-1] == "| speed [m/s] | 0.5 -> 0.02 | 0.5 -> 0.03 |  |"


def test_the_page_holds_every_part_once(dataset):
  text = page([Record(dataset, calibration(command_shift=1), validation())], {"sample": steps(0.2, 1.3)})
  assert text.count("## ") == 2 and text.count("| sample |") == 1
  assert "4 recordings: 1 identify (5 s), 3 validate (15 s)." in text
  assert "Commands act 1 control periods later than logged." in text and "* something was left at its prior" in text
  assert "Twin against" not in page([Record(dataset, calibration(), validation())], {})
