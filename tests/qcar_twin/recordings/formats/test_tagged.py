"""Samples among the lines of a simulator's log, as DeepRacer's writes them."""

import numpy as np
import pytest

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.manifest import Mapped
from qcar_twin.recordings.mapping import resolve, streams_of
from qcar_twin.recordings.recording import RecordingError


def trace(episodes=3, steps=300):
  """Lines of a simulator, and the speed that was commanded: each episode begins at the same place."""
  lines, speeds, k = ["log level: INFO", "s3 bucket: a,b,c"], [], 0
  for episode in range(episodes):
    x = y = yaw = speed = 0.0
    for step in range(steps):
      command, angle = 1.0 + 0.5 * np.sin(0.07 * step), 0.3 * np.sin(0.11 * step + episode)
      speed += (command - speed) * 0.3
      yaw += speed * np.tan(angle) / 0.165 / 15.0
      x, y = x + speed * np.cos(yaw) / 15.0, y + speed * np.sin(yaw) / 15.0
      turned = np.degrees((yaw + np.pi) % (2.0 * np.pi) - np.pi)
      cells = (episode, step + 1, f"{x:.4f}", f"{y:.4f}", f"{turned:.4f}", f"{np.degrees(angle):.2f}", f"{command:.2f}")
      rest = f"3,0.5,False,True,{0.3 * step:.4f},{step % 118},17.67,{1.7e9 + k / 15.0:.5f},in_progress,0.00"
      lines.append(f"SIM_TRACE_LOG:{','.join(map(str, cells))},{rest}")
      speeds.append(round(command, 2))
      k += 1
    lines.append("## agent: Finished episode, reset")
    k += 30
  return lines, np.array(speeds)


def test_a_simulators_trace_is_read_with_the_names_that_it_documents(tmp_path):
  lines, speeds = trace()
  path = tmp_path / "robomaker.log"
  path.write_text("\n".join([*lines, lines[5][:40]]), encoding="utf-8")  # the last line was cut off
  table = read_table(path)
  assert table.rows == speeds.size and list(table.columns)[:2] == ["episode", "steps"]
  np.testing.assert_array_equal(table.columns["speed_command [m/s]"], speeds)
  (tmp_path / "dataset.toml").write_text(propose("racer", [table]).text, encoding="utf-8")
  runs = DataSet.load(tmp_path).recordings
  assert all({"speed_command", "steering_command", "speed", "pose_x", "pose_yaw"} <= set(run.channels) for run in runs)
  assert max(np.abs(run["speed"].value).max() for run in runs) < 2.0  # no leap back to the start is a speed


FORMATS = """FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns
FMT, 129, 40, IMU, QBff, TimeUS,I,GyrZ,AccX
FMT, 130, 40, RCOU, QHH, TimeUS,C1,C3
FMT, 131, 40, MODE, QNB, TimeUS,Mode,Rsn
PARM, 1, SERVO1_FUNCTION, 26
MODE, 900000, Manual, 1
"""


def test_messages_that_a_log_describes_itself_keep_their_own_clocks(tmp_path):
  rows = [f"IMU, {20000 * k}, {sensor}, {0.01 * k + sensor:.3f}, {0.1 * k:.3f}" for k in range(50) for sensor in (0, 1)]
  rows += [f"RCOU, {40000 * k + 500}, {1500 + k}, 1600" for k in range(25)] + ["IMU, 1000"]
  (tmp_path / "run.log").write_text(FORMATS + "\n".join(rows) + "\n", encoding="utf-8")
  read = read_table(tmp_path / "run.log")
  turned, pulses = read.number("IMU.GyrZ", "yaw_rate"), read.number("RCOU.C1", "steering_command")
  there = np.isfinite(turned)
  assert turned[there] == pytest.approx(0.01 * np.arange(50)) and read.number("time", "time")[there][1] == 0.02
  assert pulses[np.isfinite(pulses)].tolist() == [1500.0 + k for k in range(25)]
  assert np.nanmin(read.number("IMU_1.GyrZ", "yaw_rate")) == 1.0
  assert "MODE.Mode" not in read and "MODE.Rsn" in read


PARAMETERS = "FMT, 140, 40, PARM, QNff, TimeUS,Name,Value,Default\n"


def test_parameters_that_are_all_written_at_once_are_no_samples(tmp_path):
  rows = [f"PARM, 37212000, SERVO{k}_MIN, {1100 + k}, 1100" for k in range(8)]
  rows += [f"IMU, {20000 * k}, 0, {0.01 * k:.3f}, 0.5" for k in range(50)]
  (tmp_path / "run.log").write_text(FORMATS + PARAMETERS + "\n".join(rows) + "\n", encoding="utf-8")
  read = read_table(tmp_path / "run.log")
  assert "IMU.GyrZ" in read and "PARM.Value" not in read and read.rows == 50
  assert read.notes == (
    "run.log: messages of 'PARM.Value' are left out: 7 of its 8 stamps repeat, so that these are no samples one after "
    "the other",
  )
  with pytest.raises(RecordingError, match="'PARM.Value' was left out, 7 of its 8 stamps repeat.*map another"):
    read.number("PARM.Value", "motor_duty")
  mapped = {"time": "time", "motor_duty": "IMU.AccX", "yaw_rate": "IMU.GyrZ", "speed": "PARM.Value"}
  with pytest.raises(RecordingError, match="'PARM.Value' was left out, 7 of its 8 stamps repeat"):
    streams_of(read, resolve(read, {channel: Mapped(column) for channel, column in mapped.items()}))


def test_messages_of_one_kind_alone_are_refused_where_their_stamps_repeat(tmp_path):
  rows = [f"IMU, {20000 * (k // 2)}, 0, {0.01 * k:.3f}, 0.5" for k in range(50)]
  (tmp_path / "run.log").write_text(FORMATS.replace("MODE, 9", "NOTE, 9") + "\n".join(rows), encoding="utf-8")
  with pytest.raises(RecordingError, match="time of 'IMU.I' goes backwards or repeats in row 2"):
    read_table(tmp_path / "run.log")


def test_units_tell_which_column_numbers_the_instances(tmp_path):
  about = "FMT, 141, 40, XKF1, QBf, TimeUS,C,GZ\nFMT, 142, 40, FMTU, QBNN, TimeUS,FmtType,UnitIds,MultIds\n"
  about += "FMTU, 900000, 141, s#k, F--\nFMTU, 900000, 7, s, F\n"
  rows = [f"XKF1, {20000 * k}, {core}, {0.1 * k + core:.1f}" for k in range(40) for core in (0, 1)]
  (tmp_path / "run.log").write_text(FORMATS + about + "\n".join(rows), encoding="utf-8")
  read = read_table(tmp_path / "run.log")
  first, second = (values[np.isfinite(values)] for values in map(read.columns.get, ("XKF1.GZ", "XKF1_1.GZ")))
  assert second - first == pytest.approx(np.ones(40)) and not any("XKF1" in note for note in read.notes)
