"""HDF5: sensors in groups with clocks of their own, units in attributes, trials beside each other."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.hierarchy import hdf5
from qcar_twin.recordings.formats.table import NoSamples, SeveralRecordings
from qcar_twin.recordings.recording import RecordingError
from scripts import new
from tests.qcar_twin.recordings.drives import drive

h5py = pytest.importorskip("h5py", reason="the extra matlab is not installed")
UNITS = {"t": "ms", "steering": "deg", "throttle": "%", "motor_speed": "rpm", "wz": "deg/s"}


def write_drive(group, seed=0):
  """Commands and motor at 50 Hz, the IMU at 100 Hz and 3 ms later, each with its clock, ms; returns the drive."""
  time, own = drive(14.0, seed=seed)
  slow = {
    "command": {"steering": np.rad2deg(own["steering_command"]), "throttle": 100.0 / 12.0 * own["motor_voltage"]},
    "drive": {"motor_speed": own["motor_speed"] * 30.0 / np.pi},
  }
  imu = {
    "wz": np.rad2deg(own["yaw_rate"]),
    "acc": np.stack([own["accel_x"], own["accel_y"], 9.81 + 0.0 * time], axis=1),
  }
  topics = {name: (time[::2], {k: v[::2] for k, v in columns.items()}) for name, columns in slow.items()}
  for name, (clock, columns) in (topics | {"imu": (time + 0.003, imu)}).items():
    for key, values in {"t": 1e3 * clock, **columns}.items():
      made = group.create_dataset(f"{name}/{key}", data=values)
      if key in UNITS:
        made.attrs["unit" if name == "imu" else "units"] = UNITS[key]
  return time, own


def test_trials_become_recordings(tmp_path, capsys):
  with h5py.File(tmp_path / "campaign.h5", "w") as file:
    own = [write_drive(file.create_group(f"data/trial_{k}"), k)[1] for k in (1, 2, 3)]
    file["data"].attrs["vehicle"] = "truck"
    file["gains"] = np.array([1.0, 2.0])
  with pytest.raises(
    SeveralRecordings, match=r"holds 3 recordings \(trial_1, trial_2, trial_3\).*qcar-twin new"
  ) as said:
    read_table(tmp_path / "campaign.h5")
  assert "gains: belongs to no recording" in said.value.tables["trial_1"].notes[0]
  new.main(new.Config(tmp_path / "lab", (tmp_path / "campaign.h5",), wheelbase=0.256, mass=2.7))
  assert "campaign.h5: holds 3 recordings" in capsys.readouterr().out
  data = DataSet.load(tmp_path / "lab")
  assert [run.file for run in data.recordings] == [f"campaign_trial_{k}.csv" for k in (1, 2, 3)]
  for run, columns in zip(data.recordings, own, strict=True):
    for channel in ("steering_command", "motor_speed", "yaw_rate", "accel_y"):
      every = 1 if channel in ("yaw_rate", "accel_y") else 2
      np.testing.assert_allclose(run[channel].value, columns[channel][::every], rtol=1e-6, atol=1e-9)
    assert run["yaw_rate"].time[0] == pytest.approx(0.003)


def test_one_recording_is_read_as_it_is_its_clock_above_its_sensors(tmp_path):
  time, own = drive(12.0)
  with h5py.File(tmp_path / "run.hdf5", "w") as file:
    file["timestamps"] = time
    for k, wheel in enumerate("ab"):
      file[f"wheel_{wheel}/speed"] = own["motor_speed"] + k
    file["imu/gyro"] = np.stack([0.0 * time, 0.0 * time, own["yaw_rate"]], axis=1)
    file["odd/lidar"] = np.arange(7.0)
    file["about"] = "words"
  table = read_table(tmp_path / "run.hdf5")
  assert list(table.columns) == ["time", "imu.gyro.x", "imu.gyro.y", "imu.gyro.z", "wheel_a.speed", "wheel_b.speed"]
  np.testing.assert_array_equal(table.columns["imu.gyro.z"], own["yaw_rate"])
  assert table.notes == ("run.hdf5: odd.lidar: no clock of 7 values in its group; left out",)


@pytest.mark.parametrize(
  ("names", "trials"),
  [
    (["wheel_1/t", "wheel_1/speed", "wheel_2/t", "wheel_2/speed", "command/t", "command/steer"], set()),
    (["left/t", "left/speed", "right/t", "right/speed"], set()),
    (["run_1/t", "run_1/speed", "run_2/t", "run_2/speed"], {"run_1", "run_2"}),
    (["oval/imu/t", "oval/imu/z", "snake/imu/t", "snake/imu/z"], {"oval", "snake"}),
    (["run_1/t", "run_1/speed", "run_1/z"], set()),
    (["a/imu/t", "a/imu/z", "b/lidar/t", "b/lidar/x"], set()),
  ],
)
def test_groups_that_hold_the_same_are_trials(names, trials):
  assert set(hdf5.trials_of([tuple(name.split("/")) for name in names])) == trials


def test_a_compound_type_has_its_fields_and_links_to_other_files_are_not_followed(tmp_path):
  time, own = drive(12.0)
  rows = np.zeros(time.size, dtype=[("time", "f8"), ("speed", "f4"), ("mode", "S4")])
  rows["time"], rows["speed"] = time, own["motor_speed"]
  with h5py.File(tmp_path / "secret.h5", "w") as file:
    file["key"] = time
  with h5py.File(tmp_path / "run.h5", "w") as file:
    file["log"] = rows
    file["elsewhere"] = h5py.ExternalLink("secret.h5", "/key")
    file["round"] = h5py.SoftLink("/")
  table = read_table(tmp_path / "run.h5")
  assert list(table.columns) == ["time", "log.speed"]


def test_what_is_no_hdf5_or_holds_none_is_said(tmp_path, monkeypatch):
  (tmp_path / "bad.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + b"\0" * 64)
  with pytest.raises(RecordingError, match=r"bad.h5: is not a readable HDF5 file"):
    read_table(tmp_path / "bad.h5")
  with h5py.File(tmp_path / "none.h5", "w") as file:
    file["about"] = "words"
  with pytest.raises(NoSamples, match="holds no vector of numbers"):
    read_table(tmp_path / "none.h5")
  monkeypatch.setattr(hdf5, "find_spec", lambda name: None)
  with pytest.raises(RecordingError, match=r"none.h5: .*pip install 'qcar-twin\[matlab\]'"):
    read_table(tmp_path / "none.h5")
