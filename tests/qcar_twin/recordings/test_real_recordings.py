"""The three real data sets load, with the samples and the warnings that a person who looked at the files expects."""

from pathlib import Path

import numpy as np
import pytest

from qcar_twin.recordings.checks.units import compare
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from tests import REAL

DATA = REAL
NAMES = ("qcar_ground", "dart", "cpm_ucar")
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="the real recordings are not here (../shared/data)")


@pytest.fixture(scope="module", params=NAMES)
def data(request):
  return DataSet.load(DATA / request.param)


@pytest.fixture(scope="module")
def dart():
  return DataSet.load(DATA / "dart")


def test_every_recording_has_what_a_fit_needs(data):
  for run in data.recordings:
    assert "motor_voltage" in run and "speed" in run
    assert 4.0 < run.duration < 200.0
    assert np.abs(run["motor_voltage"].value).max() <= 11.1
    time, commands = run.commands(0.01)
    assert commands.shape == (time.size, 2) and np.isfinite(commands).all()
    assert run.name == Path(run.file).stem  # none was cut in two


def test_counts_roles_and_duration():
  sets = [DataSet.load(DATA / name) for name in NAMES]
  assert [len(data.recordings) for data in sets] == [18, 35, 1]
  assert [[len(data.role(role)) for role in ("identify", "validate", "holdout")] for data in sets] == [
    [7, 8, 3],
    [19, 9, 7],
    [1, 0, 0],
  ]
  assert [round(sum(run.duration for run in data.recordings)) for data in sets] == [112, 1206, 82]


def test_no_unit_or_sign_is_doubted(data):
  assert not any("implausible" in note or "runs against" in note or "clipped" in note for note in data.warnings)


def test_no_channel_is_frozen_but_the_cars_that_static_friction_held(data):
  frozen = [note.split(":")[0] for note in data.warnings if "frozen" in note]
  held = ["straight_06_duty_0.025.csv", "straight_07_duty_0.030.csv", "straight_09_duty_0.040.csv"]
  assert frozen == (held if data.name == "qcar_ground" else [])


def test_what_was_loaded_can_be_written_and_read_back(data, tmp_path):
  again = DataSet.load(write_dataset(tmp_path, data.name, data.vehicle, data.vehicle_std, data.recordings))
  for before, after in zip(data.recordings, again.recordings, strict=True):
    assert before.channels == after.channels
    for channel in before.channels:
      assert (before[channel].time == after[channel].time).all() and (
        before[channel].value == after[channel].value
      ).all()


def test_cpm_ucar_has_two_asynchronous_streams():
  (run,) = DataSet.load(DATA / "cpm_ucar").recordings
  assert len(run["motor_voltage"]) == len(run["steering_command"]) == 4081
  assert {len(run[channel]) for channel in ("accel_x", "accel_y", "pose_yaw", "battery_voltage")} == {4051}
  assert len(run["speed"]) == 4050  # one reading of 0.70 m/s between 1.26 and 1.26 is none
  assert np.intersect1d(run["motor_voltage"].time, run["speed"].time).size == 0
  assert np.abs(np.diff(run["pose_yaw"].value)).max() < 0.5  # unwrapped
  assert run["speed"].value.min() < 0.0 < run["speed"].value.max()


def test_dart_without_vicon_keeps_every_onboard_sample(dart):
  run = dart["step_16"]
  assert run.channels == ("motor_voltage", "steering_command", "speed", "accel_x", "accel_y", "yaw_rate")
  assert {len(run[channel]) for channel in run.channels} == {160}


def test_dart_with_vicon_has_onboard_at_10_hz_and_pose_at_100_hz(dart):
  for run in dart.recordings:
    if "pose_x" not in run:
      continue
    for channel in ("speed", "accel_x", "yaw_rate", "motor_voltage"):
      assert np.median(np.diff(run[channel].time)) == pytest.approx(0.1, abs=0.002)
    assert np.median(np.diff(run["pose_x"].time)) == pytest.approx(0.01, abs=0.0005)
    assert run.start > 10.0  # the stale rows at time 0 are gone


def test_dart_pose_times_agree_with_the_motion_capture_clock(dart):
  """Spread between the onboard stamps, the pose is within milliseconds of its own clock, which the mapping ignores."""
  raw = np.genfromtxt(DATA / "dart" / "free_driving" / "free_01.csv", delimiter=",", names=True)
  valid = raw["elapsed_time_sensors"] > 0.0
  error = dart["free_01"]["pose_x"].time - raw["vicon_time"][valid]
  assert np.std(error) < 0.004 and np.ptp(error) < 0.02


def test_dart_gate_leaves_no_voltage_before_the_safety_switch(dart):
  raw = np.genfromtxt(DATA / "dart" / "steering_staircase" / "stair_02.csv", delimiter=",", names=True)
  first = (np.diff(raw["elapsed_time_sensors"], prepend=0.0) > 0.0) & (raw["elapsed_time_sensors"] > 0.0)
  voltage = dart["stair_02"]["motor_voltage"].value
  assert (voltage == 8.0 * raw["throttle"][first] * raw["safety_value"][first]).all()
  assert raw["throttle"][first][raw["safety_value"][first] == 0.0].any()  # a throttle that must not act


def test_gyro_and_encoder_agree_with_motion_capture_once_loaded(dart):
  for comparison in compare(dart["free_02"], dart.vehicle)[:2]:
    slope, correlation = comparison.slope()
    assert slope == pytest.approx(1.0, abs=0.05) and correlation > 0.99
