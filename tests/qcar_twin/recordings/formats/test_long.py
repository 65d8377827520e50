"""Long tables: a row for every signal and stamp."""

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError

ROWS = [(k + late, name, k + 0.5) for name, late in (("speed", 0.0), ("/cmd.throttle", 0.25)) for k in range(20)]
BOTH = {"speed": np.arange(20.0), "/cmd.throttle": np.arange(20.0) + 0.25}


def write(path, header, rows):
  path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]), encoding="utf-8")
  return path


@pytest.mark.parametrize("order", ["a signal after another", "by time"])
def test_each_signal_is_a_column_on_its_own_stamps(tmp_path, order):
  rows = sorted(ROWS) if order == "by time" else ROWS
  table = read_table(write(tmp_path / "run.csv", "time,topic,value", rows))
  assert set(table.columns) == {"time", *BOTH}
  for name, stamps in BOTH.items():
    sampled = np.isfinite(table.columns[name])
    np.testing.assert_array_equal(table.columns["time"][sampled], stamps)
    np.testing.assert_array_equal(table.columns[name][sampled], np.arange(20) + 0.5)


def test_of_several_clocks_that_of_the_header_counts_and_other_texts_are_no_signals(tmp_path):
  rows = [(t + 7.0, "car", t, name, value) for t, name, value in ROWS]
  table = read_table(write(tmp_path / "run.csv", "receive time,host,header.stamp,topic,value", rows))
  assert table.columns["time"][0] == 0.0 and set(table.columns) == {"time", *BOTH}


def test_parquet_too(tmp_path):
  time, names, values = zip(*ROWS, strict=True)
  pyarrow.parquet.write_table(pyarrow.table({"t": time, "signal": names, "value": values}), tmp_path / "run.parquet")
  assert set(read_table(tmp_path / "run.parquet").columns) == {"time", *BOTH}


def test_a_text_beside_other_numbers_names_no_signals(tmp_path):
  rows = [(t, name, value, value) for t, name, value in sorted(ROWS)]
  table = read_table(write(tmp_path / "run.csv", "time,mode,data,speed", rows))
  assert {"time", "data", "speed"} <= set(table.columns)


def test_one_without_a_clock_that_rises_is_refused(tmp_path):
  rows = [(7.0, name, value) for _, name, value in ROWS]
  with pytest.raises(
    RecordingError, match=r"run.csv: is a long table: 'topic' has the names of 2 signals.*no column is a clock"
  ):
    read_table(write(tmp_path / "run.csv", "time,topic,value", rows))


def decoded(tmp_path, rows):
  """A CAN bus's signals as decoders write them: the message's identifier and name, the signal, its value and unit."""
  lines = [";".join(map(str, row)) for row in sorted(rows)]
  path = tmp_path / "can.csv"
  path.write_text("\n".join(["time;id;message;signal;value;unit", *lines]), encoding="utf-8")
  return read_table(path)


def test_signals_of_a_bus_have_their_units_and_what_tells_of_a_signal_is_no_sample(tmp_path):
  signals = (("0x101", "STEER", "SteerAngle", "deg"), ("0x102", "STATE", "Enabled", ""), ("0x102", "STATE", "SOC", "%"))
  rows = [(k, number, message, signal, k, unit) for k in range(20) for number, message, signal, unit in signals]
  table = decoded(tmp_path, rows)
  assert set(table.columns) == {"time", "SteerAngle [deg]", "Enabled", "SOC [%]"}
  np.testing.assert_array_equal(table.columns["SteerAngle [deg]"], np.arange(20.0))


def test_a_signal_of_two_messages_is_called_after_both_and_two_units_are_two_columns(tmp_path):
  rows = [(k, n, m, "speed", k, "m/s") for k in range(20) for n, m in ((1, "FRONT"), (2, "REAR"))]
  rows += [(k, 3, "ROOF", "wind", k, "m/s" if k < 10 else "km/h") for k in range(20)]
  names = {"FRONT.speed [m/s]", "REAR.speed [m/s]", "wind [m/s]", "wind [km/h]"}
  assert set(decoded(tmp_path, rows).columns) == {"time", *names}
