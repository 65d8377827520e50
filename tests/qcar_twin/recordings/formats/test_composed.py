"""Columns that others make up: lists in cells, a quaternion of a turn on the floor, milliseconds behind a colon."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.recording import RecordingError

TIME = np.arange(60) / 50.0


def read(tmp_path, head, rows):
  (tmp_path / "log.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
  return read_table(tmp_path / "log.csv")


@pytest.mark.parametrize("mark", [", ", "  "], ids=["lists", "arrays"])
def test_a_list_in_a_cell_has_its_elements(tmp_path, mark):
  cells = [f'"[{mark.join(f"{k + i / 10:.1f}" for i in range(3))}]"' if k != 7 else "" for k in range(60)]
  table = read(tmp_path, "time,gyro", [f"{t:.2f},{cell}" for t, cell in zip(TIME, cells, strict=True)])
  z = table.number("gyro.z", "yaw_rate")
  assert np.isnan(z[7]) and np.delete(z, 7) == pytest.approx(np.delete(np.arange(60) + 0.2, 7))


def test_lists_of_other_lengths_and_words_are_none(tmp_path):
  rows = [f'{t:.2f},"[{", ".join(["1.0"] * (1 + k % 3))}]","[a, b]"' for k, t in enumerate(TIME)]
  assert list(read(tmp_path, "time,ranges,names", rows).columns) == ["time", "ranges", "names"]


def test_numbers_with_one_unit_in_every_cell_have_it_in_their_name(tmp_path):
  rows = [f"{t:.2f},{k} %,-{k}.5e0 m/s,{k} m,{k}x" for k, t in enumerate(TIME)]
  rows[3] = "0.06,,3 m/s,3 ft,"
  table = read(tmp_path, "time,throttle,speed,way,code", rows)
  assert list(table.columns) == ["time", "throttle", "speed", "way", "code", "throttle [%]", "speed [m/s]"]
  assert np.isnan(table.number("throttle [%]", "motor_duty")[3])
  assert table.number("speed [m/s]", "speed")[2:5] == pytest.approx([-2.5, 3.0, -4.5])
  with pytest.raises(RecordingError, match=r"its numbers are in column 'speed \[m/s\]': map that in \[channels\]"):
    table.number("speed", "speed")


def test_a_draft_says_why_numbers_in_another_spelling_are_not_read(tmp_path):
  rows = [f'"{1e3 * t:_.1f}",0.3,0.1,1.0,on' for t in np.arange(300) / 50.0]
  text = propose("lab", [read(tmp_path, "time_ms,throttle,steering,speed,mode", rows)]).text
  assert "column 'time_ms' has '1_000.0' in row 51, which is not a number" in text and "'mode' has" not in text


@pytest.mark.parametrize("name", ["orientation", "car.orient", "attitude"])
def test_a_quaternion_without_x_and_y_turns_on_the_floor(tmp_path, name):
  yaw = 0.1 * np.arange(60)
  rows = [f"{t:.2f},{np.sin(0.5 * a):.9f},{np.cos(0.5 * a):.9f}" for t, a in zip(TIME, yaw, strict=True)]
  turned = read(tmp_path, f"time,{name}.z,{name}.w", rows).number(f"{name}.yaw", "pose_yaw")
  assert np.exp(1j * turned) == pytest.approx(np.exp(1j * yaw), abs=1e-6)
  assert np.abs(turned).max() <= np.pi + 1e-9  # so that it jumps by one turn, not by two


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
@pytest.mark.parametrize("up", ["y", "z"])
def test_a_quaternion_by_numbers_turns_about_what_is_upright(tmp_path, order, up):
  yaw = 0.1 * np.arange(60)
  parts = {"w": np.cos(0.5 * yaw), "x": 0.0 * yaw, "y": 0.0 * yaw, "z": 0.0 * yaw, up: np.sin(0.5 * yaw)}
  rows = [f"{t:.2f}," + ",".join(f"{parts[name][k]:.9f}" for name in order) for k, t in enumerate(TIME)]
  turned = read(tmp_path, "time,quat[0],quat[1],quat[2],quat[3]", rows).number("quat_yaw", "pose_yaw")
  assert np.exp(1j * turned) == pytest.approx(np.exp(1j * yaw), abs=1e-6)
  assert np.abs(turned).max() <= np.pi + 1e-9


def test_an_imu_of_six_numbers_has_its_force_where_gravity_is(tmp_path):
  level = [(0.3 * np.sin(t), 0.2, 9.8, 0.01, 0.02, t) for t in TIME]
  head = "time," + ",".join(f"imu[{k}]" for k in range(6))
  for order in ((0, 1, 2, 3, 4, 5), (3, 4, 5, 0, 1, 2)):
    rows = [f"{t:.2f}," + ",".join(f"{six[k]:.6f}" for k in order) for t, six in zip(TIME, level, strict=True)]
    table = read(tmp_path, head, rows)
    assert table.number("imu.acc.z", "accel_x") == pytest.approx(9.8)
    assert table.number("imu.gyro.z", "yaw_rate") == pytest.approx(TIME, abs=1e-6)
  rows = [f"{t:.2f},0.1,0.2,0.3,0.1,0.2,{t:.3f}" for t in TIME]  # no gravity: nothing says which is which
  assert "imu.gyro.z" not in read(tmp_path, head, rows)


def test_milliseconds_behind_a_colon_are_no_frames(tmp_path):
  rows = [f"14:00:0{int(t)}:{round(1e3 * (t % 1.0)):03d},1.0" for t in TIME]
  assert np.diff(read(tmp_path, "time,speed", rows).number("time", "time")) == pytest.approx(0.02)
  with pytest.raises(RecordingError, match="not a number"):
    read(tmp_path, "time,speed", ["14:00:00:23,1.0", "14:00:00:24,1.0"]).number("time", "time")


def test_stamps_in_columns_secs_and_nsecs_alone_are_one_clock(tmp_path):
  rows = [f"{1562950800 + int(t)},{round(1e9 * (t % 1.0))},{k}" for k, t in enumerate(TIME)]
  table = read(tmp_path, "secs,nsecs,data", rows)
  assert table.number("stamp", "time") - 1562950800.0 == pytest.approx(TIME, abs=1e-6)


@pytest.mark.parametrize(("sigma", "is_one"), [(0.004, True), (0.2, False)])
def test_a_quaternion_that_is_of_length_one_but_for_noise_is_a_rotation(tmp_path, sigma, is_one):
  yaw, random = np.linspace(-1.0, 1.0, 60), np.random.default_rng(1)
  parts = np.stack([0.0 * yaw, 0.0 * yaw, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]) + sigma * random.normal(size=(4, 60))
  table = read(
    tmp_path, "time,qx,qy,qz,qw", [f"{t},{','.join(map(str, q))}" for t, q in zip(TIME, parts.T, strict=True)]
  )
  assert ("q_yaw" in table) == is_one
  if is_one:
    assert table.number("q_yaw", "pose_yaw") == pytest.approx(yaw, abs=0.05)
