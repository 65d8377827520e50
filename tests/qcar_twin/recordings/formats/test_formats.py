"""Every file format gives the same recording; every damaged file says what is wrong with it and what to do."""

import os

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import scipy.io

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.formats import read_table, readers
from qcar_twin.recordings.recording import RecordingError
from tests.counting import calls
from tests.qcar_twin.recordings.drives import drive, folder_with, write_csv, write_manifest

TIME, COLUMNS = drive(3.0)


def refused(path, *texts):
  with pytest.raises(RecordingError) as caught:
    table = read_table(path)
    for column in table.columns:
      table.number(column, column)
  for text in texts:
    assert text in str(caught.value)
  assert str(caught.value).startswith(path.name)


def same(table, exact=True):
  assert (table.columns["time"] == TIME).all()
  for name, column in COLUMNS.items():
    assert table.columns[name] == pytest.approx(column, abs=0.0 if exact else 1e-12)


def loads_as(tmp_path, file, **manifest):
  data = DataSet.load(write_manifest(tmp_path, (file,), **manifest))
  (run,) = data.recordings
  return run


# ---------------------------------------------------------------- CSV


@pytest.mark.parametrize("separator, decimal", [(",", "."), (";", "."), (";", ","), ("\t", ".")])
def test_csv_dialects(tmp_path, separator, decimal):
  same(read_table(write_csv(tmp_path / "a.csv", TIME, COLUMNS, separator, decimal)))


@pytest.mark.parametrize("name", ["läuft über.csv", "実験 1.csv", "a b'c#1.csv"])
def test_unicode_and_odd_file_names(tmp_path, name):
  write_csv(tmp_path / name, TIME, COLUMNS)
  assert loads_as(tmp_path, name).name == name[:-4]


def test_symlinks_are_followed_and_broken_ones_are_missing_files(tmp_path):
  store = tmp_path / "store"
  store.mkdir()
  write_csv(store / "real.csv", TIME, COLUMNS)
  (tmp_path / "link.csv").symlink_to(store / "real.csv")
  assert loads_as(tmp_path, "link.csv").name == "link"
  (tmp_path / "broken.csv").symlink_to(store / "gone.csv")
  refused(tmp_path / "broken.csv", "no such file", "check `file` in dataset.toml")


def test_byte_order_mark_windows_line_ends_latin_names_and_spaces_are_read(tmp_path):
  path = tmp_path / "a.csv"
  path.write_bytes(b"\xef\xbb\xbf" + "time, motor_voltage ,v (°)\r\n0.0, 1.5 ,2\r\n0.1,1.5,3\r\n".encode())
  table = read_table(path)
  assert list(table.columns) == ["time", "motor_voltage", "v (°)"]
  assert table.number("motor_voltage", "motor_voltage").tolist() == [1.5, 1.5]
  path.write_bytes("time,v (°)\n0.0,2\n".encode("latin-1"))
  assert list(read_table(path).columns) == ["time", "v (°)"]


def test_numbers_that_appear_late_in_a_long_integer_column_are_read(tmp_path):
  path = tmp_path / "a.csv"
  rows = [f"{k},0," for k in range(200_000)] + ["200000,0.5,7.25"]
  path.write_text("time,motor_voltage,speed\n" + "\n".join(rows))
  table = read_table(path)
  assert (
    table.columns["motor_voltage"][-1] == 0.5
    and table.columns["speed"][-1] == 7.25
    and np.isnan(table.columns["speed"][0])
  )


def test_blank_and_nan_cells_are_told_apart_and_blank_rows_at_the_end_are_dropped(tmp_path):
  path = tmp_path / "a.csv"
  path.write_text("time,speed\n0,1\n1,\n2,nan\n3,NaN\n,\n,\n")
  table = read_table(path)
  assert table.rows == 4
  assert np.isnan(table.columns["speed"]).tolist() == [False, True, True, True]
  assert table.not_a_number["speed"].tolist() == [2, 3]


def test_time_stamps_written_as_dates_become_seconds(tmp_path):
  path = tmp_path / "a.csv"
  path.write_text("time,speed\n2024-08-30 10:00:00.00,1\n2024-08-30 10:00:00.25,2\n")
  assert np.diff(read_table(path).number("time", "time")) == pytest.approx([0.25], abs=1e-6)


@pytest.mark.parametrize(
  "content, texts",
  [
    (b"", ["the file is empty (0 bytes)"]),
    (b"\n\n", ["the file is empty"]),
    (b"time,motor_voltage,speed\n", ["has column names but no rows"]),
    (
      b"time:motor_voltage\n0:1\n",
      ["only one column was found ('time:motor_voltage'); separate the columns by commas"],
    ),
    (b"time,speed\n0,1\n1,abc\n", ["column 'speed' has 'abc' in row 2", "not a number", "leave the cell blank"]),
    (b"time,speed\n0,1\n10:31,2\n", ["column 'time' has '10:31' in row 2", "time must be a number of seconds"]),
    (b"time,speed,speed\n0,1,2\n", ["column 'speed' occurs more than once"]),
    (b"\x89PNG\x00\x00time,speed\n", ["is no text, or damaged: it holds zero bytes", "save it as CSV UTF-8"]),
  ],
)
def test_damaged_csv_is_named(tmp_path, content, texts):
  path = tmp_path / "a.csv"
  path.write_bytes(content)
  refused(path, *texts)


def test_duplicate_columns_that_nobody_needs_do_no_harm(tmp_path):
  write_csv(tmp_path / "a.csv", TIME, COLUMNS | {"x": TIME, "y": TIME})
  text = (tmp_path / "a.csv").read_text()
  (tmp_path / "a.csv").write_text(text.replace(",x,y", ",note,note", 1))
  assert "yaw_rate" in loads_as(tmp_path, "a.csv")


def test_unknown_suffix_and_missing_file(tmp_path):
  (tmp_path / "a.xlsx").write_bytes(b"PK")
  refused(tmp_path / "a.xlsx", "cannot read '.xlsx' files; readable are: .csv", ".mcap")
  refused(tmp_path / "b.csv", "no such file in")
  assert {".csv", ".parquet", ".npz", ".mat", ".mcap", ".bag"} <= set(readers())


def test_a_file_that_may_not_be_read_says_so(tmp_path, monkeypatch):
  path = write_csv(tmp_path / "a.csv", TIME, COLUMNS)
  os.chmod(path, 0)
  monkeypatch.setattr(
    "qcar_twin.recordings.formats.text.samples.dialect_of", lambda *_: (_ for _ in ()).throw(PermissionError("denied"))
  )
  refused(path, "cannot be read (denied); check the file and its permissions")


# ---------------------------------------------------------------- Parquet and NPZ


def test_parquet_null_is_a_blank_and_nan_is_a_nan(tmp_path):
  speed = pyarrow.array([1.0, None, float("nan"), 4.0])
  pyarrow.parquet.write_table(
    pyarrow.table({"time": [0.0, 0.1, 0.2, 0.3], "speed": speed, "count": [1, 2, 3, 4]}), tmp_path / "a.parquet"
  )
  table = read_table(tmp_path / "a.parquet")
  assert table.not_a_number["speed"].tolist() == [2]
  assert table.columns["count"].dtype == float


def test_parquet_time_stamps_become_seconds(tmp_path):
  stamps = pyarrow.array([1_700_000_000_000, 1_700_000_000_250], type=pyarrow.timestamp("ms"))
  pyarrow.parquet.write_table(pyarrow.table({"time": stamps, "speed": [1.0, 2.0]}), tmp_path / "a.parquet")
  assert np.diff(read_table(tmp_path / "a.parquet").columns["time"]) == pytest.approx([0.25], abs=1e-6)


def test_parquet_and_npz_hold_the_same_as_csv(tmp_path):
  pyarrow.parquet.write_table(pyarrow.table({"time": TIME, **COLUMNS}), tmp_path / "a.parquet")
  np.savez(tmp_path / "b.npz", time=TIME, version=3, **{key: value[:, None] for key, value in COLUMNS.items()})
  same(read_table(tmp_path / "a.parquet"))
  same(read_table(tmp_path / "b.npz"))
  one, two = loads_as(tmp_path, "a.parquet"), loads_as(tmp_path, "b.npz")
  assert one.channels == two.channels == tuple(COLUMNS)


def test_damaged_parquet_and_npz_are_named(tmp_path):
  (tmp_path / "a.parquet").write_bytes(b"PAR1 nonsense")
  refused(tmp_path / "a.parquet", "is not a readable Parquet file", "write it again")
  (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 nonsense")
  refused(tmp_path / "a.npz", "is not a readable NPZ file", "numpy.savez")
  np.savez(tmp_path / "c.npz", time=TIME)
  content = bytearray((tmp_path / "c.npz").read_bytes())
  content[4] = 250  # a version of zip that nobody wrote
  content[content.rindex(b"PK\x01\x02") + 6] = 250
  (tmp_path / "c.npz").write_bytes(content)
  refused(tmp_path / "c.npz", "is damaged, or not the .npz file it is called", "write it again")
  np.savez(tmp_path / "b.npz", note=np.array("text"))
  refused(tmp_path / "b.npz", "holds no numeric vectors")


def test_npz_objects_are_never_unpickled(tmp_path):
  class Bomb:
    def __reduce__(self):
      return (os.mkdir, (str(tmp_path / "exploded"),))

  np.savez(tmp_path / "a.npz", time=TIME, motor_voltage=np.array([Bomb()], dtype=object))
  refused(tmp_path / "a.npz", "array 'motor_voltage' holds Python objects, which are never unpickled")
  assert not (tmp_path / "exploded").exists()


def test_npz_with_a_clock_for_the_arrays_of_each_length_keeps_their_times(tmp_path):
  imu, encoder = np.arange(0.0, 3.0, 0.01), np.arange(0.0, 3.0, 0.04)
  np.savez(tmp_path / "a.npz", t_imu=imu, gyro=np.sin(imu), t_encoder=encoder, speed=np.cos(encoder), rate=25.0)
  table = read_table(tmp_path / "a.npz")
  for name, time, values in (("gyro", imu, np.sin(imu)), ("speed", encoder, np.cos(encoder))):
    there = np.isfinite(table.columns[name])
    np.testing.assert_array_equal(table.columns["time"][there], time)
    np.testing.assert_array_equal(table.columns[name][there], values)


def test_npz_with_several_clocks_of_one_length_goes_by_their_names_else_by_their_order(tmp_path):
  encoder, servo = np.arange(0.0, 3.0, 0.01), np.arange(0.0, 3.0, 0.01) + 0.003
  arrays = {"t_enc": encoder, "FL": encoder, "t_ecu": servo, "motor": servo, "v_enc": encoder, "yaw": np.arange(7.0)}
  np.savez(tmp_path / "a.npz", **arrays, t_imu=np.arange(7.0) / 10.0)
  table = read_table(tmp_path / "a.npz")
  for name, time in (("FL", encoder), ("v_enc", encoder), ("motor", servo), ("yaw", np.arange(7.0) / 10.0)):
    np.testing.assert_allclose(table.columns["time"][np.isfinite(table.columns[name])], time)


def test_npz_of_unequal_lengths_lists_them(tmp_path):
  np.savez(tmp_path / "a.npz", time=TIME, speed=TIME[::2], motor_voltage=TIME)
  refused(
    tmp_path / "a.npz",
    "arrays must have one length (300 samples, as time): speed has 150",
    "pad channels of another rate with NaN",
  )


# ---------------------------------------------------------------- MATLAB


def test_mat_vectors(tmp_path):
  scipy.io.savemat(tmp_path / "a.mat", {"time": TIME, "gain": 3.0, "note": "text", **COLUMNS})
  same(read_table(tmp_path / "a.mat"))
  assert loads_as(tmp_path, "a.mat").channels == tuple(COLUMNS)


def test_mat_version_4_matrix_of_quarc_has_time_in_its_first_row(tmp_path):
  scipy.io.savemat(tmp_path / "a.mat", {"log": np.vstack([TIME, *COLUMNS.values()])}, format="4")
  table = read_table(tmp_path / "a.mat")
  assert (table.columns["time"] == TIME).all()
  for number, column in enumerate(COLUMNS.values(), 2):
    assert (table.columns[f"log({number})"] == column).all()


def test_mat_matrix_may_lie_either_way_and_is_mapped_by_number(tmp_path):
  scipy.io.savemat(
    tmp_path / "a.mat", {"log": np.column_stack([TIME, COLUMNS["motor_voltage"], COLUMNS["motor_speed"]])}
  )
  run = loads_as(
    tmp_path, "a.mat", channels='motor_voltage = { column = "log(2)" }\nmotor_speed = { column = "log(3)" }'
  )
  assert (run["motor_speed"].value == COLUMNS["motor_speed"]).all()


def structure(time, **signals):
  """A Simulink structure with time."""
  entries = np.zeros(
    len(signals), dtype=[("values", object), ("dimensions", object), ("label", object), ("blockName", object)]
  )
  for row, (label, values) in enumerate(signals.items()):
    entries[row] = (np.atleast_2d(values).T, 1.0, label, f"model/{label}")
  return {"time": time[:, None], "signals": entries, "blockName": "model/To Workspace"}


def test_mat_structure_with_time_is_named_by_its_labels(tmp_path):
  scipy.io.savemat(tmp_path / "a.mat", {"log": structure(TIME, **COLUMNS)})
  table = read_table(tmp_path / "a.mat")
  same(table)
  assert (table.columns["log.yaw_rate"] == COLUMNS["yaw_rate"]).all()
  assert loads_as(tmp_path, "a.mat").channels == tuple(COLUMNS)


def test_mat_structure_without_labels_uses_the_block_and_numbers_vector_signals(tmp_path):
  signals = {"values": np.column_stack([COLUMNS["accel_x"], COLUMNS["accel_y"]]), "label": "", "blockName": "car/IMU"}
  scipy.io.savemat(
    tmp_path / "a.mat", {"log": {"time": TIME, "signals": signals}, "motor_voltage": COLUMNS["motor_voltage"]}
  )
  table = read_table(tmp_path / "a.mat")
  assert (table.columns["log.IMU(2)"] == COLUMNS["accel_y"]).all() and (
    table.columns["IMU(1)"] == COLUMNS["accel_x"]
  ).all()
  assert (table.columns["motor_voltage"] == COLUMNS["motor_voltage"]).all()


@pytest.mark.parametrize("axes", [1, 2])
def test_mat_structure_of_controldesk_is_named_by_the_ends_of_its_paths(tmp_path, axes):
  fields = [("Name", object), ("Unit", object), ("Data", object), ("XIndex", object)]
  signals = np.empty((1, 2), dtype=fields)
  signals[0, 0] = ('"Model Root/RC/delta"', "deg", COLUMNS["steering_command"], 1)
  signals[0, 1] = ('"Model Root/IMU/psi_p"', "", COLUMNS["yaw_rate"], axes)
  clocks = np.empty((1, axes), dtype=[("Name", object), ("Data", object)])
  for number in range(axes):
    clocks[0, number] = ("time", TIME + 0.001 * number)
  scipy.io.savemat(tmp_path / "a.mat", {"rec1": {"X": clocks, "Y": signals, "Description": {"General": "x"}}})
  table = read_table(tmp_path / "a.mat")
  assert set(table.columns) == {"time", "delta [deg]", "psi_p"}
  sampled = np.isfinite(table.columns["psi_p"])
  np.testing.assert_allclose(table.columns["time"][sampled], TIME + 0.001 * (axes - 1))
  np.testing.assert_array_equal(table.columns["psi_p"][sampled], COLUMNS["yaw_rate"])


def test_mat_structures_of_different_rates_are_merged(tmp_path):
  fast = structure(TIME, motor_voltage=COLUMNS["motor_voltage"], motor_speed=COLUMNS["motor_speed"])
  slow = structure(TIME[::5] + 0.002, pose_x=COLUMNS["pose_x"][::5], pose_y=COLUMNS["pose_y"][::5])
  scipy.io.savemat(tmp_path / "a.mat", {"car": fast, "lidar": slow})
  run = loads_as(tmp_path, "a.mat")
  assert (run["motor_speed"].time == TIME).all() and (run["pose_x"].time == TIME[::5] + 0.002).all()
  assert (run["pose_y"].value == COLUMNS["pose_y"][::5]).all()


def test_mat_structure_of_vectors_and_nested_structures(tmp_path):
  log = {"t": TIME, **COLUMNS, "meta": {"driver": "A", "gain": 2.0}, "note": "x"}
  scipy.io.savemat(tmp_path / "a.mat", {"log": {"run": log}})
  table = read_table(tmp_path / "a.mat")
  same(table)
  assert (table.columns["log.run.accel_x"] == COLUMNS["accel_x"]).all()


def test_mat_with_a_broken_clock_names_the_structure(tmp_path):
  time = TIME.copy()
  time[7] = time[6]
  scipy.io.savemat(tmp_path / "a.mat", {"log": structure(time, speed=TIME)})
  table = read_table(tmp_path / "a.mat", "a.mat")
  assert table.rows == TIME.size - 1 and "1 of" in table.notes[0] and "first at" in table.notes[0]
  time[7] = time[2]
  scipy.io.savemat(tmp_path / "a.mat", {"log": structure(time, speed=TIME)})
  refused(tmp_path / "a.mat", "time of 'log.", "goes backwards or repeats in row 8")


def test_mat_7_3_and_damaged_files_name_the_cure(tmp_path):
  header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b"\x00" * 8 + b"\x00\x02IM"
  (tmp_path / "a.mat").write_bytes(header + b"\x89HDF\r\n\x1a\n" + b"\x00" * 400)
  refused(tmp_path / "a.mat", "is a MATLAB 7.3 (HDF5) file", 'save("log.mat", "-v7")')
  (tmp_path / "b.mat").write_bytes(b"nonsense" * 40)
  refused(tmp_path / "b.mat", "is not a readable .mat file")
  scipy.io.savemat(tmp_path / "c.mat", {"note": "only text"})
  refused(
    tmp_path / "c.mat",
    "holds neither numeric vectors nor structures with time nor timeseries",
    "structures with time",
  )


def test_nan_in_a_format_without_blanks_is_no_sample_when_common_and_a_fault_when_rare(tmp_path):
  voltage = np.where(np.arange(TIME.size) % 2, COLUMNS["motor_voltage"], np.nan)
  np.savez(tmp_path / "a.npz", time=TIME, motor_voltage=voltage, motor_speed=COLUMNS["motor_speed"])
  assert len(loads_as(tmp_path, "a.npz")["motor_voltage"]) == 150
  voltage = COLUMNS["motor_voltage"].copy()
  voltage[[40, 41]] = np.nan
  np.savez(tmp_path / "a.npz", time=TIME, motor_voltage=voltage, motor_speed=COLUMNS["motor_speed"])
  with pytest.raises(RecordingError, match="a.npz: motor_voltage is NaN in row 41 and 1 more; leave the cell blank"):
    loads_as(tmp_path, "a.npz")


def test_a_log_of_ten_times_the_length_takes_no_more_calls(tmp_path):
  """Rows are read in one go, however many there are."""
  taken = []
  for k, seconds in enumerate((18.0, 180.0)):
    (tmp_path / str(k)).mkdir()
    folder = folder_with(tmp_path / str(k), *drive(seconds))
    DataSet.load(folder)
    taken.append(calls(lambda folder=folder: DataSet.load(folder)))
  assert taken[1] < 1.2 * taken[0]


def test_mat_structure_of_a_scope_has_its_titles(tmp_path):
  plot = np.column_stack([COLUMNS["accel_x"], COLUMNS["accel_y"]])
  signals = {"values": plot, "label": np.empty(0), "title": "ACCELERATION (m/s^2)"}
  scipy.io.savemat(tmp_path / "a.mat", {"SCOPE": {"time": TIME, "signals": signals}})
  table = read_table(tmp_path / "a.mat")
  assert (table.number("ACCELERATION (m/s^2)(2)", "accel_y") == COLUMNS["accel_y"]).all()
