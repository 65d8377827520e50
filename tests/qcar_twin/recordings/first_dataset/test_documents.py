"""Documents of results beside logs: what is taken for a log of a folder, and what is not."""

import json

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.place import is_document, logs_of, placed, with_rows
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.table import NoSamples
from tests.qcar_twin.recordings.drives import drive

FEW, MANY = 3, 48
RISING = [0.1 * k for k in range(MANY)]
# shapes of documents that commands write
RESULTS = {
  "calibration": {"parameters": {"mass": {"value": 2.7, "std": 0.1}}, "notes": ["one", "two", "three"]},
  "fit": {"key": "ab", "result": {"theta": {"mass": 2.7}}},
  "check": {"findings": [{"what": "a"}, {"what": "b"}], "sampling": [{"rate": 100.0, "jitter": 0.1}] * 6},
  "diagnosis": {"claims": [{"probability": 0.9}] * 2, "where": {"time": [{"start": 1.0, "end": 2.0}] * 5}},
  "evidence": {"models": [{"drop": 1.0}] * 9, "scanned": [{"gain": x} for x in RISING]},
  "posterior": {"models": [{"probability": 0.2, "values": [1.0, 2.0]}, {"probability": 0.8, "values": [1.5, 2.0]}]},
  "ranking": {"stage": "scan", "ranking": [{"mechanism": str(x), "evidence_nats": -x} for x in RISING], "claims": []},
  "cross": {"difference": {"grid": RISING, "by_speed": RISING[:21], "by_lateral": RISING[:15]}},
  "loss": {"target": "single-track", "alone": [{"speed": 1.0 + k, "yaw_rate": 2.0 - k} for k in range(FEW)]},
  "settings": {"rate": 5, "limits": [-0.5, 0.5]},
  "sentences": ["one", "two", "three"],
}
BLOCKS = [{"from": x, "channels": {"speed": {"time": RISING, "measured": RISING}}} for x in RISING]
SCANNED = [{"log": f"{k}.csv", "car": str(k), "stamp": [100, k], "level": "check"} for k in range(MANY)]
LINES = {"watch": BLOCKS, "scan": SCANNED}
MANIFEST = ["cam/image_array", "user/angle"], ["image_array", "float"], {}, {"paths": ["catalog_0.catalog"]}


def log_of(seconds, clock="time"):
  """A drive, a sample an object."""
  time, columns = drive(seconds)
  named = {clock: time, "throttle": columns["motor_voltage"] / 8.0, "gyro_z": columns["yaw_rate"]}
  return [dict(zip(named, map(float, row), strict=True)) for row in zip(*named.values(), strict=True)]


def lines(said):
  return "".join(f"{json.dumps(one)}\n" for one in said)


@pytest.fixture
def folder(tmp_path):
  """A log, and next to it what commands have written."""
  for name, said in RESULTS.items():
    (tmp_path / f"{name}.json").write_text(json.dumps(said, indent=1), encoding="utf-8")
  for name, said in LINES.items():
    (tmp_path / f"{name}.ndjson").write_text(lines(said), encoding="utf-8")
  (tmp_path / "manifest.json").write_text(lines(MANIFEST), encoding="utf-8")
  (tmp_path / "run.json").write_text(json.dumps(log_of(5.0)), encoding="utf-8")
  return tmp_path


def test_results_are_no_logs_and_a_log_beside_them_is_one(folder, capsys):
  assert [path.name for path in folder.iterdir() if not is_document(path)] == ["run.json"]
  ((log, table),) = with_rows(placed(folder, logs_of([folder])))
  assert log.name == "run.json" and table.rows == len(log_of(5.0))
  said = capsys.readouterr().out
  assert all(f"left out: {name}.json: " in said for name in (*RESULTS, "manifest"))
  assert "left out: ranking.json: no column of 20 rows and more is a clock" in said
  assert "left out: watch.ndjson: 'channels.speed.time' is a list of times" in said


@pytest.mark.parametrize(
  "said",
  [
    log_of(5.0),
    log_of(5.0, "Zeit"),
    {name: [row[name] for row in log_of(5.0)] for name in ("time", "throttle", "gyro_z")},
    [list(row.values()) for row in log_of(5.0)],
    [{"t": x, "Drehzahl": x % 0.7} for x in RISING],
    {"imu": [{"t": 0.1 * k, "gyro": k} for k in range(49)], "odom": [{"t": 0.2 * k, "v": k} for k in range(25)]},
    {"t": RISING, "v": RISING[:21]},
  ],
  ids=["objects", "another clock", "lists", "rows", "another column", "two clocks", "a list that is cut off"],
)
def test_logs_in_json_are_logs(tmp_path, said):
  (path := tmp_path / "log.json").write_text(json.dumps(said), encoding="utf-8")
  assert not is_document(path)


@pytest.mark.parametrize("text", ["", '[{"t": 0', '[{"t": 0}, 5]'])
def test_a_log_that_is_damaged_stays_one_so_that_it_is_said(tmp_path, text):
  (path := tmp_path / "log.json").write_text(text, encoding="utf-8")
  assert not is_document(path)


def test_where_nothing_else_is_a_document_without_a_clock_is_the_log(tmp_path):
  (path := tmp_path / "log.json").write_text(json.dumps([{"speed": x % 7} for x in range(MANY)]), encoding="utf-8")
  ((log, table),) = with_rows(placed(tmp_path, [path]))
  assert log.source == path and table.rows == MANY
  (path := tmp_path / "notes.json").write_text(json.dumps(RESULTS["cross"]), encoding="utf-8")
  with pytest.raises(NoSamples, match="holds lists of several lengths and no clock"):
    read_table(path)


def test_a_stamp_of_parts_is_no_block_of_samples(tmp_path):
  rows = [{"stamp": [k, 5], "date": [2026, 3, 1, 10, 0, k, 250], "v": 0.5} for k in range(FEW)]
  (path := tmp_path / "log.jsonl").write_text(lines(rows), encoding="utf-8")
  np.testing.assert_array_equal(read_table(path).columns["stamp[0]"], np.arange(FEW))


def test_a_drive_that_was_broken_off_is_a_log_and_a_table_of_laps_is_none(tmp_path):
  rows = [{"time": 0.05 * k, "throttle": 0.1, "steering": 0.01 * k, "speed": 0.02 * k} for k in range(15)]
  (tmp_path / "drive.json").write_text(json.dumps(rows), encoding="utf-8")
  laps = [{"time": 12.0 * k, "lap": k, "speed": 1.0 + 0.1 * k} for k in range(15)]
  (tmp_path / "laps.json").write_text(json.dumps(laps), encoding="utf-8")
  assert not is_document(tmp_path / "drive.json") and is_document(tmp_path / "laps.json")
