"""MATLAB's timeseries, alone, in structures and in Simulink's Datasets, each with a clock of its own, and version 7.3.

The files are written by mat-io with the properties that MATLAB gives its timeseries on disk; none of MATLAB's own was
at hand.
"""

import importlib.util

import numpy as np
import pytest
import scipy.io

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.formats import matlab, read_table
from qcar_twin.recordings.recording import RecordingError
from tests.qcar_twin.recordings.drives import drive, write_manifest

matio = pytest.importorskip("matio", reason="the extra matlab is not installed")
NOTHING = np.empty((0, 0))
VERSIONS = pytest.mark.parametrize("version", ["v7", "v7.3"])


def an_object(kind, **properties):
  from matio.utils.matclass import MatlabOpaque

  return MatlabOpaque(properties, kind)


def series(values, time=None, start=0.0, step=None, units="seconds", name=""):
  """A timeseries as MATLAB stores it: uniform times are not listed."""
  number = lambda value: NOTHING if value is None else np.array([[float(value)]])
  values = np.asarray(values, dtype=float)
  about = an_object(
    "tsdata.timemetadata",
    Start_=number(start if step else None), Increment_=number(step), Length=number(len(values)), Time_=NOTHING,
    Units=units,
  )  # fmt: skip
  return an_object(
    "timeseries",
    Name=name, Data_=values.reshape(len(values), -1), TimeInfo_=about,
    Time_=NOTHING if time is None else np.asarray(time, dtype=float).reshape(-1, 1),
  )  # fmt: skip


def written(path, version, **variables):
  matio.save_to_mat(str(path), variables, version=version)
  return read_table(path)


def at(table, column):
  """Times and values of a column where it has samples."""
  there = np.isfinite(table.columns[column])
  return table.columns["time"][there], table.columns[column][there]


@VERSIONS
def test_several_timeseries_have_their_own_clocks(tmp_path, version):
  time = np.array([0.0, 0.011, 0.019, 0.032])
  table = written(
    tmp_path / "a.mat", version,
    speed=series([1.0, 2.0, 3.0, 4.0], time),
    gyro=series(np.arange(8.0), start=0.5, step=0.01),
    late=series([5.0, 6.0], [1.0, 2.0], units="milliseconds"),
    both=series([[1.0, -1.0], [2.0, -2.0], [3.0, -3.0], [4.0, -4.0]], time),
  )  # fmt: skip
  assert np.array_equal(at(table, "speed"), (time, [1.0, 2.0, 3.0, 4.0]))
  assert np.allclose(at(table, "gyro"), (0.5 + 0.01 * np.arange(8), np.arange(8.0)), rtol=0.0, atol=1e-12)
  assert np.allclose(at(table, "late"), ([0.001, 0.002], [5.0, 6.0]))
  assert np.array_equal(at(table, "both(2)")[1], [-1.0, -2.0, -3.0, -4.0])


@VERSIONS
def test_timeseries_in_a_dataset_and_in_a_structure_are_found_by_their_names(tmp_path, version):
  signal = lambda name, values: an_object(
    "Simulink.SimulationData.Signal", Name=name, Values=series(values, step=0.02, name=name)
  )
  elements = np.empty((1, 2), dtype=object)
  elements[0, 0], elements[0, 1] = signal("speed", [1.0, 2.0, 3.0]), signal("yaw_rate", [4.0, 5.0, 6.0])
  dataset = an_object("Simulink.SimulationData.Dataset", Name="logsout", Elements_=elements)
  table = written(tmp_path / "a.mat", version, out=dataset, log={"volts": series([7.0, 8.0], step=0.03)})
  assert {"speed", "yaw_rate", "log.volts", "volts"} <= set(table.columns)
  assert np.array_equal(at(table, "yaw_rate")[1], [4.0, 5.0, 6.0]) and at(table, "volts")[0][1] == 0.03


def test_objects_are_read_with_the_plain_variables_of_their_file(tmp_path):
  plain = {"time": np.array([0.0, 0.01, 0.02]), "values": np.array([1.0, 2.0, 3.0])}
  table = written(tmp_path / "a.mat", "v7", speed=series([1.0, 2.0], step=0.05), log=plain)
  assert {"speed", "log.values"} <= set(table.columns) and at(table, "values")[1].tolist() == [1.0, 2.0, 3.0]


def test_a_session_of_timeseries_loads_as_it_was_driven(tmp_path):
  time, columns = drive(12.0)
  clocks = {"motor_voltage": 1, "steering_command": 1, "motor_speed": 2, "yaw_rate": 1, "accel_y": 5}
  slower = {name: series(columns[name][::k], time[::k]) for name, k in clocks.items()}
  matio.save_to_mat(str(tmp_path / "run.mat"), slower, version="v7")
  (run,) = DataSet.load(write_manifest(tmp_path, files=("run.mat",))).recordings
  for name, k in clocks.items():
    assert np.array_equal(run[name].time, time[::k]) and np.array_equal(run[name].value, columns[name][::k]), name


def test_version_7_3_is_read_with_its_plain_variables(tmp_path):
  log = {"time": np.array([0.0, 0.01, 0.02]), "speed": np.array([1.0, 2.0, 3.0])}
  table = written(tmp_path / "a.mat", "v7.3", log=log)
  assert at(table, "speed")[1].tolist() == [1.0, 2.0, 3.0]


@VERSIONS
def test_without_the_extra_the_error_names_it_and_what_to_write_in_matlab(tmp_path, version, monkeypatch):
  matio.save_to_mat(str(tmp_path / "a.mat"), {"speed": series([1.0, 2.0], step=0.05)}, version=version)
  real = importlib.util.find_spec
  monkeypatch.setattr(matlab, "find_spec", lambda name: None if name == "matio" else real(name))
  with pytest.raises(RecordingError, match=r"pip install 'qcar-twin\[matlab\]'; or in MATLAB") as said:
    read_table(tmp_path / "a.mat")
  assert 'save("log.mat", ' in str(said.value)


def test_what_matlab_is_told_to_write_is_read_without_the_extra(tmp_path, monkeypatch):
  monkeypatch.setattr(matlab, "find_spec", lambda name: None)
  structure = {"time": np.array([[0.0], [0.05], [0.1]]), "speed": np.array([[1.0], [2.0], [3.0]])}
  scipy.io.savemat(tmp_path / "log.mat", {"s": structure})
  assert at(read_table(tmp_path / "log.mat"), "speed")[1].tolist() == [1.0, 2.0, 3.0]
