"""What exports say of the drive's command, and nothing where its largest is not known; signs stay, names do no harm."""

import dataclasses
import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from calibration.exports.export import export_twin
from calibration.exports.numbers import single_track_numbers
from calibration.exports.target import Job
from calibration.exports.yaml_numbers import read_numbers
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import GRAVITY, Vehicle

FORMATS = {"f1tenth": "", "commonroad": "longitudinal."}


def written(target, folder, **changes):
  """Job, numbers and text of a car's file."""
  twin = Twin(dataclasses.replace(Vehicle(), **changes), threads=1)
  job = Job(twin, twin.parameters.nominal)
  path, _ = export_twin(target, job, folder)
  return job, read_numbers(path), path.read_text(encoding="utf-8")


@pytest.mark.parametrize("target", FORMATS)
@pytest.mark.parametrize("drive", ["speed", "acceleration", "current"])
def test_where_the_largest_command_is_not_known_no_speed_is_made_of_the_supply(target, drive, tmp_path):
  job, made, text = written(target, tmp_path, drive=drive)
  of = FORMATS[target]
  mu = single_track_numbers(job.twin, job.theta, ())["friction_coefficient"]
  assert made[f"{of}a_max"] == pytest.approx(mu * GRAVITY)
  assert not {f"{of}v_max", f"{of}v_min", f"{of}v_switch"} & made.keys()
  assert "# v_min, v_max and v_switch are not in it" in text


@pytest.mark.parametrize("target", FORMATS)
def test_a_current_ends_at_the_largest_torque(target, tmp_path):
  weak = 0.005
  job, made, _ = written(target, tmp_path, drive="current", max_torque=weak)
  own, of = single_track_numbers(job.twin, job.theta, ()), FORMATS[target]
  pull = own["travel_per_radian"] * own["drive_gain"] * weak / job.twin.vehicle.torque_per_ampere
  assert made[f"{of}a_max"] == pytest.approx(min(pull, own["friction_coefficient"] * GRAVITY), rel=1e-6)
  assert made[f"{of}v_max"] == pytest.approx(pull / own["drive_damping"], rel=1e-6) == -made[f"{of}v_min"]


@pytest.mark.parametrize("target", ["single-track", *FORMATS])
@pytest.mark.parametrize(("drive", "unit"), [("voltage", "V"), ("duty", "V"), ("current", "A"), ("speed", "m/s")])
def test_the_gain_is_in_the_unit_of_what_the_model_is_commanded(target, drive, unit, tmp_path):
  assert f"rad/s^2 per {unit}, P1" in written(target, tmp_path, drive=drive)[2]


@pytest.mark.parametrize("target", ["single-track", "f1tenth"])
@pytest.mark.parametrize(("axle", "said"), [("open", "none of them"), ("locked", "the locked axle")])
def test_a_locked_axle_that_a_file_lacks_is_said(target, axle, said, tmp_path):
  assert f"Not in this file: {said}." in written(target, tmp_path, layout="rear", differential=axle)[2]


def test_a_voltage_ends_at_the_supply(tmp_path):
  job, made, text = written("f1tenth", tmp_path)
  own = single_track_numbers(job.twin, job.theta, ())
  pull = own["travel_per_radian"] * own["drive_gain"] * job.twin.vehicle.supply_voltage
  assert made["v_max"] == pytest.approx(pull / own["drive_damping"]) and "not in it" not in text


@pytest.mark.parametrize("target", ["single-track", "f1tenth", "commonroad", "mjcf"])
def test_a_car_whose_centre_differential_is_open_is_exported(target, tmp_path):
  twin = Twin(dataclasses.replace(Vehicle(), centre_differential=1.0), threads=1)
  path, _ = export_twin(target, Job(twin, twin.parameters.nominal), tmp_path)
  text = path.read_text(encoding="utf-8")
  assert not re.search(r"\b(inf|nan)\b", text)


def test_a_cars_name_ends_no_comment_of_xml(tmp_path):
  twin = Twin(dataclasses.replace(Vehicle(), name="red---2"), threads=1)
  path, _ = export_twin("mjcf", Job(twin, twin.parameters.nominal), tmp_path)
  assert ElementTree.parse(path).getroot().tag == "mujoco"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_motor_that_is_wired_the_other_way_stays_so(sign, tmp_path):
  present = tmp_path / "now.yaml"
  servo = "  steering_angle_to_servo_gain: -1.2\n  steering_angle_to_servo_offset: 0.5\n"
  present.write_text(f"vesc:\n  speed_to_erpm_gain: {sign * 4614.0}\n{servo}", encoding="utf-8")
  twin = Twin(Vehicle(), threads=1)
  job = Job(twin, twin.parameters.nominal, options={"pole_pairs": "2", "vesc": str(present)})
  made = read_numbers(export_twin("vesc", job, tmp_path)[0])["speed_to_erpm_gain"]
  travel = twin.vehicle.gear_ratio * twin.vehicle.wheel_radius
  assert made == pytest.approx(sign * 2 * 60 / (2 * math.pi * travel)) and np.isfinite(made)


def test_what_both_commands_wait_is_written_as_two_delays():
  twin = Twin(Vehicle(), select(["command_delay", "steering_delay"]), threads=1)
  theta = twin.parameters.vector({"command_delay": 0.03, "steering_delay": 0.01})
  numbers = single_track_numbers(twin, theta, twin.mechanisms)
  assert (numbers["drive_delay"], numbers["steering_delay"]) == pytest.approx((0.03, 0.04))
  assert "command_delay" not in numbers
