"""Text as other people's tools write it: preambles, several lines of names, units, comments, marks, durations."""

import json
import subprocess
import sys

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.place import Placed, logs_of, with_rows
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError

ROWS = [f"{k / 50:.2f},{k % 7},{0.1 * k:.1f}" for k in range(60)]
NAMES = "time,throttle,speed"


def read(tmp_path, lines, name="log.csv", encoding="utf-8"):
  path = tmp_path / name
  path.write_text("\n".join(lines) + "\n", encoding=encoding)
  return read_table(path)


@pytest.mark.parametrize(
  ("lines", "names"),
  [
    (["made by a logger, version 2", "", "Driver,Somebody", NAMES, *ROWS], ["time", "throttle", "speed"]),
    ([NAMES, "ms,%,km/h", *ROWS], ["time [ms]", "throttle [%]", "speed [km/h]"]),
    (["Format,3", NAMES, "s,,m/s", ",100: gps,200: obd", *ROWS], ["time [s]", "throttle", "speed [m/s]"]),
    (
      ["Format,3", "time,speed,speed", "s,km/h,m/s", ",100: gps,200: obd", *ROWS],
      ["time [s]", "speed 100: gps [km/h]", "speed 200: obd [m/s]"],
    ),
    (["Take,a", ",car,car", ",Turn,Place", "Time,X,X", *ROWS], ["Time", "car Turn X", "car Place X"]),
    (["\ufeff# a car", "# a day", NAMES, *ROWS[:40], "# the battery", *ROWS[40:]], ["time", "throttle", "speed"]),
    (["# time,throttle,speed", *ROWS], ["time", "throttle", "speed"]),
    (["Run A,carpet,", "row,throttle,speed", "#,%,mph", *ROWS], ["row", "throttle [%]", "speed [mph]"]),
  ],
  ids=[
    "preamble",
    "units",
    "units and sources",
    "a name twice",
    "several lines of names",
    "comments and a mark",
    "commented names",
    "units below a number of the row",
  ],
)
def test_the_lines_above_the_numbers_name_the_columns(tmp_path, lines, names):
  table = read(tmp_path, lines)
  assert list(table.columns) == names
  np.testing.assert_allclose(table.columns[names[2]], 0.1 * np.arange(60))


def test_words_below_a_header_that_are_no_units_are_still_refused(tmp_path):
  with pytest.raises(RecordingError, match="row 1 repeats the header"):
    read(tmp_path, [NAMES, NAMES, *ROWS])


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "latin1"])
def test_a_spreadsheets_encodings(tmp_path, encoding):
  lines = ["Zeit [s];Längsbeschleunigung [m/s²]", *(f"{k};0,5" for k in range(20))]
  table = read(tmp_path, lines, encoding=encoding)
  assert list(table.columns) == ["Zeit [s]", "Längsbeschleunigung [m/s²]"]
  np.testing.assert_array_equal(table.columns["Längsbeschleunigung [m/s²]"], 0.5)


def test_decimal_commas_in_quotes_between_commas(tmp_path):
  table = read(tmp_path, ["time,speed", *(f'"0,{k:02d}","-1,5"' for k in range(20))])
  np.testing.assert_allclose(table.columns["time"], 0.01 * np.arange(20))
  np.testing.assert_array_equal(table.columns["speed"], -1.5)


@pytest.mark.parametrize(
  "stamp", [lambda t: f"{t:g} sec", lambda t: f"{1e3 * t:g} ms", lambda t: f"0 days 00:00:{t:09.6f}"]
)
def test_durations_are_seconds(tmp_path, stamp):
  table = read(tmp_path, ["Time,speed", *(f"{stamp(k / 50)},1" for k in range(60))])
  np.testing.assert_allclose(table.columns["Time"], np.arange(60) / 50, atol=1e-9)


@pytest.mark.parametrize("name", ["log.jsonl", "log.ndjson", "catalog_0.catalog"])
def test_json_lines(tmp_path, name):
  rows = [{"t": 0.1 * k, "imu": {"gyro": [0.0, 0.0, k]}, "mode": "user", "v": None if k == 3 else k} for k in range(9)]
  table = read(tmp_path, map(json.dumps, rows), name)
  assert set(table.columns) == {"t", "imu.gyro[0]", "imu.gyro[1]", "imu.gyro[2]", "v"}
  assert np.flatnonzero(np.isnan(table.columns["v"])).tolist() == [3]
  np.testing.assert_array_equal(table.columns["imu.gyro[2]"], np.arange(9.0))


def test_json_that_was_cut_off_names_the_line(tmp_path):
  with pytest.raises(RecordingError, match=r"line 2 is no JSON.*cut off"):
    read(tmp_path, ['{"t": 0}', '{"t": 1'], "log.jsonl")
  with pytest.raises(RecordingError, match=r"line 1 is no JSON object"):
    read(tmp_path, ["[1, 2]"], "log.jsonl")


SAMPLES = [{"t": f"2026-03-01T10:00:0{k}.5Z", "v": 0.5 * k, "imu": {"gyro": [0.0, k]}} for k in range(5)]
DOCUMENTS = {
  "a list": SAMPLES,
  "within a description": {"meta": {"car": 1, "lock": [-0.5, 0.5]}, "samples": SAMPLES},
  "pandas, index": {str(k): row for k, row in enumerate(SAMPLES)},
  "pandas, table": {"schema": {"fields": []}, "data": SAMPLES},
}
COLUMNS = {
  "lists": {"t": [0, 1, 2], "v": [1.5, None, 2.5]},
  "lists within": {"log": {"t": [0, 1, 2], "v": [1.5, None, 2.5]}},
  "pandas, columns": {"t": {"0": 0, "1": 1, "2": 2}, "v": {"0": 1.5, "1": None, "2": 2.5}},
  "pandas, split": {"columns": ["t", "v"], "index": [0, 1, 2], "data": [[0, 1.5], [1, None], [2, 2.5]]},
}


@pytest.mark.parametrize("said", DOCUMENTS.values(), ids=DOCUMENTS)
def test_a_json_document_of_samples(tmp_path, said):
  table = read(tmp_path, [json.dumps(said, indent=1)], "log.json")
  assert set(table.columns) == {"t", "v", "imu.gyro[0]", "imu.gyro[1]"}
  np.testing.assert_array_equal(np.diff(table.columns["t"]), np.ones(4))
  np.testing.assert_array_equal(table.columns["imu.gyro[1]"], np.arange(5.0))


@pytest.mark.parametrize("said", COLUMNS.values(), ids=COLUMNS)
def test_a_json_document_of_columns(tmp_path, said):
  table = read(tmp_path, [json.dumps(said)], "log.json")
  assert set(table.columns) == {"t", "v"}
  np.testing.assert_array_equal(table.columns["v"], [1.5, np.nan, 2.5])


def test_json_lists_with_clocks_of_their_own_keep_their_times(tmp_path):
  said = {"imu": [{"t": 0.1 * k, "gyro": k} for k in range(9)], "odom": [{"t": 0.2 * k, "v": k} for k in range(5)]}
  table = read(tmp_path, [json.dumps(said)], "log.json")
  assert table.rows == 9
  np.testing.assert_array_equal(table.columns["odom.v"][::2], np.arange(5.0))


def test_json_rows_have_no_names(tmp_path):
  assert read(tmp_path, ["[[0, 1], [1, 2]]"], "log.json").headless
  with pytest.raises(RecordingError, match="row 2 has 1 values, and the first 2"):
    read(tmp_path, ["[[0, 1], [1]]"], "log.json")


@pytest.mark.parametrize(
  ("text", "said"),
  [
    ('{"rate": 5}', "holds no list of samples"),
    ('[{"t": 0', "is no JSON.*cut off"),
    ('[{"t": 0}, 5]', "element 2 is no JSON object"),
  ],
)
def test_json_that_is_no_log(tmp_path, text, said):
  with pytest.raises(RecordingError, match=said):
    read(tmp_path, [text], "log.json")


def test_a_json_description_is_left_out_of_a_folder_of_logs(tmp_path, capsys):
  (tmp_path / "meta.json").write_text('{"rate": 5}')
  (tmp_path / "log.json").write_text(json.dumps(COLUMNS["lists"]))
  logs = [Placed(path, path.name, copied=False) for path in logs_of([tmp_path])]
  assert [log.name for log, _ in with_rows(logs)] == ["log.json"]
  assert "left out: meta.json: holds no list of samples" in capsys.readouterr().out


def test_a_packed_log_is_to_be_unpacked(tmp_path):
  (tmp_path / "log.csv.gz").write_bytes(b"\x1f\x8b")
  with pytest.raises(RecordingError, match="log.csv.gz: is packed; unpack it first"):
    read_table(tmp_path / "log.csv.gz")
  with pytest.raises(RecordingError, match=r"unpack log\.csv\.gz first"):
    logs_of([tmp_path])


@pytest.mark.parametrize("stem", ["q_", "/pf/pose/pose/orientation/"])
@pytest.mark.parametrize(("names", "turned"), [("wxyz", "z"), ("wxyz", "y"), ("WXYZ", "Z")])
def test_the_yaw_of_a_quaternion_is_about_the_axis_that_it_turns_about(tmp_path, names, turned, stem):
  yaw = np.linspace(-3.0, 3.0, 40)
  parts = {name: np.zeros(40) for name in names} | {names[0]: np.cos(0.5 * yaw), turned: np.sin(0.5 * yaw)}
  lines = [
    ",".join(f"{stem}{name}" for name in names),
    *(",".join(f"{parts[n][k]:.9f}" for n in names) for k in range(40)),
  ]
  np.testing.assert_allclose(read(tmp_path, lines).columns[f"{stem}yaw"], yaw, atol=1e-6)


def test_libraries_are_imported_before_the_memory_is_bounded(tmp_path):
  path = tmp_path / "log.csv"
  path.write_text("\n".join([NAMES, *ROWS]))
  code = (
    "import sys; from pathlib import Path; from qcar_twin.recordings.formats.text import samples"
    "; before = set(sys.modules); samples.read_text(Path(sys.argv[1]), 'log.csv'); print(*(set(sys.modules) - before))"
  )
  ran = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
  assert not {"pandas", "pyarrow.pandas_compat"} & set(ran.stdout.split())


def test_a_range_and_a_rate_behind_a_name_leave_its_unit(tmp_path):
  header = '"Interval"|"ms"|0|0|1,"AccelX"|"G"|-3.0|3.0|50,"Yaw"|"Deg/Sec"|-120|120|50,"TPS"|""|0.0|100.0|50'
  (tmp_path / "rc.csv").write_text(f"{header}\n0,0.1,2.0,0\n20,0.2,1.0,5\n")
  assert list(read_table(tmp_path / "rc.csv").columns) == ["Interval [ms]", "AccelX [G]", "Yaw [Deg/Sec]", "TPS"]


def test_a_first_row_with_words_where_all_rows_have_words_is_no_header(tmp_path):
  (tmp_path / "drive.csv").write_text("a/left_1.jpg,0,0.5,3E-06\na/left_2.jpg,0.1,0.5,0.2\na/left_3.jpg,0.1,0.5,0.4\n")
  assert read_table(tmp_path / "drive.csv").headless
  (tmp_path / "named.csv").write_text("time,1,2,3\n0.0,0.1,0.5,0.2\n0.1,0.1,0.5,0.4\n")
  assert list(read_table(tmp_path / "named.csv").columns) == ["time", "1", "2", "3"]


SPACED = ["# time motor_voltage speed", "0.00 1.0 0.10", " 0.01   1.5  0.11", "# a note", "0.02 -2.0   1e-3", ""]


@pytest.mark.parametrize("name", ["run.csv", "run.txt", "run.log"])
@pytest.mark.parametrize("mark", ["# ", "#", "  "])
def test_columns_that_blanks_are_between(tmp_path, name, mark):
  (tmp_path / name).write_text("\n".join([mark + SPACED[0][2:], *SPACED[1:]]), encoding="utf-8")
  table = read_table(tmp_path / name)
  assert list(table.columns) == ["time", "motor_voltage", "speed"]
  assert table.columns["motor_voltage"].tolist() == [1.0, 1.5, -2.0]


def test_blanks_without_a_header_and_a_row_that_is_torn(tmp_path):
  (tmp_path / "run.txt").write_text("0.0 1 2\n0.1 1 2\n0.2 1 2\n", encoding="utf-8")
  assert read_table(tmp_path / "run.txt").headless
  (tmp_path / "run.txt").write_text("time a b\n0.0 1 2\n0.1 1\n0.2 1 2\n", encoding="utf-8")
  with pytest.raises(RecordingError, match="run.txt: a row does not fit the header"):
    read_table(tmp_path / "run.txt")
