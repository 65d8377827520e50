"""JSON documents that hold several recordings, at any depth, and units of their values."""

import json

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.table import SeveralRecordings
from scripts import new
from tests.qcar_twin.recordings.drives import drive

UNITS = {"acc": "mg", "gyro": "mdps", "speed": "cm/s", "v": "mm/s", "mass": "stones"}


def samples(seed, seconds=14.0):
  time, own = drive(seconds, seed=seed)
  speed = 0.0953668 * 0.033 * own["motor_speed"]
  return own, [
    {
      "dt_ms": 0.0 if k == 0 else 10.0 + 0.5 * (-1) ** k,
      "cmd": {"steer": own["steering_command"][k], "throttle": own["motor_voltage"][k] / 12.0},
      "imu": {"acc": [own["accel_x"][k] / 9.80665e-3, own["accel_y"][k] / 9.80665e-3, 1000.0], "gyro": [0.0, 0.0, g]},
      "odo": {"v": 1e3 * speed[k]},
      "seen": [{"id": 1}, {"id": 2}],
    }
    for k, g in enumerate(np.rad2deg(own["yaw_rate"]) * 1e3)
  ]


def write(path, said):
  path.write_text(json.dumps(said), encoding="utf-8")
  return path


def test_runs_in_one_document_become_recordings_in_the_units_that_it_states(tmp_path, capsys):
  runs = [samples(k) for k in (1, 2, 3)]
  listed = [{"id": f"r{k}", "t0": "2025-01-17T16:00:05Z", "samples": run} for k, (_, run) in enumerate(runs, 1)]
  write(tmp_path / "all.json", {"meta": {"car": "x", "units": UNITS}, "data": {"runs": listed}})
  new.main(new.Config(tmp_path / "lab", (tmp_path / "all.json",), wheelbase=0.256, mass=2.7))
  assert "all.json: holds 3 recordings" in capsys.readouterr().out
  data = DataSet.load(tmp_path / "lab")
  assert [run.name for run in data.recordings] == ["all_r1", "all_r2", "all_r3"]
  for run, (own, _) in zip(data.recordings, runs, strict=True):
    np.testing.assert_allclose(run["yaw_rate"].value, own["yaw_rate"], atol=1e-9)
    np.testing.assert_allclose(run["speed"].value, 0.0953668 * 0.033 * own["motor_speed"], atol=1e-9)
    np.testing.assert_allclose(run["accel_y"].value, own["accel_y"], atol=1e-9)


def columnwise(seed):
  time, own = drive(12.0, seed=seed)
  return {"time": list(time), "speed": list(own["motor_speed"]), "gyro": {"z": list(own["yaw_rate"])}}


@pytest.mark.parametrize(
  ("said", "names"),
  [
    ([{"samples": samples(k)[1]} for k in (1, 2)], ["1", "2"]),
    ({"drives": {f"run_{k}": {"log": samples(k)[1]} for k in (1, 2)}}, ["run_1", "run_2"]),
    ({"drives": {"a": [{"name": n, "log": columnwise(3)} for n in ("oval", "step")]}}, ["oval", "step"]),
  ],
)
def test_runs_are_found_wherever_they_lie(tmp_path, said, names):
  with pytest.raises(SeveralRecordings, match="qcar-twin new FOLDER runs.json") as error:
    read_table(write(tmp_path / "runs.json", said))
  assert list(error.value.tables) == names
  assert all(table.rows >= 1200 for table in error.value.tables.values())


@pytest.mark.parametrize("wrap", [lambda run: run, lambda run: {"log": run}, lambda run: {"runs": [{"samples": run}]}])
def test_one_run_is_read_as_it_is_whatever_lists_its_samples_hold(tmp_path, wrap):
  table = read_table(write(tmp_path / "run.json", wrap(samples(1)[1])))
  assert table.rows == 1400 and {"dt_ms", "cmd.steer", "imu.gyro[2]", "odo.v"} <= set(table.columns)
  assert table.label == "run.json"


def test_topics_by_name_and_their_units(tmp_path):
  time, own = drive(12.0)
  topics = {
    "imu": [{"stamp": t, "gyro": [0.0, 0.0, g]} for t, g in zip(time, own["yaw_rate"], strict=True)],
    "motor": [{"stamp": t, "speed": v, "speed_kmh [km/h]": v} for t, v in zip(time, own["motor_speed"], strict=True)],
  }
  table = read_table(write(tmp_path / "run.json", {**topics, "units": {"gyro": "rad/s", "motor.speed": "rpm"}}))
  assert {"imu.gyro.z [rad/s]", "motor.speed [rpm]", "motor.speed_kmh [km/h]"} <= set(table.columns)
