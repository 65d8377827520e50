"""Where, when, in which direction and on which side a session was driven changes no result.

A small session, the same 1.7e9 s later, (500000, 5400000) m away and turned by 170 degrees, and the same in a mirror,
both written and loaded: identification, calibration, cross-validation, estimation and diagnosis are compared.
"""

import numpy as np
import pytest

from calibration import calibrate, cross_validate, diagnose, identify
from calibration.diagnosis.search.structure import Effort
from qcar_twin.estimation.offline import filter_recording
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Stream
from qcar_twin.vehicle.vehicle import Vehicle
from tests.scripts import tiny_session

LATER, AWAY, ANGLE = 1.7e9, (500000.0, 5400000.0), np.deg2rad(170.0)
ACROSS = ("steering_command", "accel_y", "yaw_rate", "pose_y", "pose_yaw")
AMONG = ("side_force", "steering_gain_error", "steering_offset")
SIDED = (
  "accel_bias_y",
  "floor_slope_y",
  "gyro_bias",
  "imu_lever_arm_y",
  "imu_misalignment",
  "pose_mount_y",
  "pose_mount_yaw",
  "steering_asymmetry",
  "steering_offset",
)  # with a sign of their own
IN_ROOM = ("floor_slope_x", "floor_slope_y")  # components of a vector that turns with the room


def moved(recording):
  """The same run, later, elsewhere, in another direction."""
  x, y, yaw = (recording[name] for name in ("pose_x", "pose_y", "pose_yaw"))
  cos, sin = np.cos(ANGLE), np.sin(ANGLE)
  values = {"pose_x": AWAY[0] + cos * x.value - sin * y.value, "pose_y": AWAY[1] + sin * x.value + cos * y.value}
  values["pose_yaw"] = yaw.value + ANGLE
  streams = {name: Stream(s.time + LATER, values.get(name, s.value)) for name, s in recording.streams.items()}
  return recording.replace(streams=streams, before=None)


def mirrored(recording):
  """The same run with left for right."""
  sign = lambda name: -1.0 if name in ACROSS else 1.0
  streams = {name: Stream(s.time, sign(name) * s.value) for name, s in recording.streams.items()}
  return recording.replace(streams=streams, before=None)


def expected(parameters, change):
  """A car's parameters after its session was changed so."""
  if change == "mirrored":
    return {name: -value if name in SIDED else value for name, value in parameters.items()}
  x, y = (parameters[name] for name in IN_ROOM)
  cos, sin = np.cos(ANGLE), np.sin(ANGLE)
  return {**parameters, **dict(zip(IN_ROOM, (cos * x - sin * y, sin * x + cos * y), strict=True))}


def results(data):
  """What identification, calibration, cross-validation, estimation and diagnosis make of a session, as numbers."""
  identified = identify(data)
  fit = calibrate(data, against="recordings", quick=True, threads=1)
  replay = cross_validate(data, fit.twin, fit.theta, reference=None).replays[-1]
  effort = Effort(singles=1, pairs=0, triples=0, iterations=1)
  diagnosed = diagnose(data, AMONG, (fit.twin, fit.theta), effort, threads=1).diagnosis
  bicycle, theta = identified.bicycle(Vehicle.from_dataset(data.vehicle, data.vehicle_std))
  return {
    "identified": {"drive": identified.drive.values, "lateral": identified.lateral.values},
    "calibrated": fit.twin.parameters.named(fit.theta),
    "std": {name: estimate.noise_std for name, estimate in fit.estimates.items()},
    "scores": {name: score.rmse for name, score in replay.scores("twin").items()},
    "scanned": {row.name: row.gain for row in diagnosed.evidence.scanned},
    "estimates": filter_recording(data["steering_0.1"], bicycle.car(theta)).value,
  }


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
  """Results of a session as it was driven, moved and in a mirror, each written and loaded."""
  work = tmp_path_factory.mktemp("sessions")
  noise = tiny_session.NOISE | {"pose_x": 1e-3, "pose_y": 1e-3, "pose_yaw": 1e-3}
  base = tiny_session.write(work / "base", noise=noise)
  made = {"base": results(base)}
  cars = {"moved": base.vehicle, "mirrored": {**base.vehicle, "imu_y": -float(base.vehicle["imu_y"])}}
  for name, change in (("moved", moved), ("mirrored", mirrored)):
    write_dataset(work / name, name, cars[name], base.vehicle_std, [change(r) for r in base.recordings])
    made[name] = results(DataSet.load(work / name))
  return made


@pytest.mark.parametrize("change", ["moved", "mirrored"])
def test_what_is_identified_is_the_same(sessions, change):
  for name, values in sessions["base"]["identified"].items():
    assert sessions[change]["identified"][name] == pytest.approx(values, rel=1e-6), name


@pytest.mark.parametrize("change", ["moved", "mirrored"])
def test_what_is_calibrated_is_the_same_and_what_has_a_side_is_mirrored(sessions, change):
  before, after = sessions["base"]["calibrated"], sessions[change]["calibrated"]
  assert before.keys() == after.keys() and before["gyro_bias"] != 0.0 and before["floor_slope_x"] != 0.0
  for name, value in expected(before, change).items():
    # 1.7e9 s resolve 0.24 us, in which a motor at 1e4 rad/s^2 gains a few thousandths of its sensor's noise
    enough = max(1e-7, 3e-3 * sessions["base"]["std"].get(name, 0.0))
    assert after[name] == pytest.approx(value, rel=1e-4, abs=enough), name


@pytest.mark.parametrize("change", ["moved", "mirrored"])
def test_errors_on_unseen_runs_are_the_same(sessions, change):
  assert sessions[change]["scores"] == pytest.approx(sessions["base"]["scores"], rel=1e-4)


@pytest.mark.parametrize("change", ["moved", "mirrored"])
def test_the_evidence_of_every_mechanism_is_the_same(sessions, change):
  assert len(sessions["base"]["scanned"]) > 0
  assert sessions[change]["scanned"] == pytest.approx(sessions["base"]["scanned"], abs=1e-3)


def test_estimates_move_with_the_session(sessions):
  before, after = sessions["base"]["estimates"], sessions["moved"]["estimates"]
  x, y = before["pose_x"], before["pose_y"]
  cos, sin = np.cos(ANGLE), np.sin(ANGLE)
  expected = before | {"pose_x": cos * x - sin * y, "pose_y": sin * x + cos * y, "pose_yaw": before["pose_yaw"] + ANGLE}
  for name, values in expected.items():
    apart = after[name] - values
    apart -= apart[0] if name in ("pose_x", "pose_y") else 0.0  # places are counted from the first one, whole metres
    if name == "pose_yaw":
      apart = np.angle(np.exp(1j * apart))
    assert np.abs(apart).max() < 1e-6, name


def test_estimates_of_a_mirrored_session_are_mirrored(sessions):
  before, after = sessions["base"]["estimates"], sessions["mirrored"]["estimates"]
  for name, values in before.items():
    sign = -1.0 if name in (*ACROSS, "sideslip_angle") else 1.0
    assert after[name] == pytest.approx(sign * values, abs=1e-9), name
