"""Everyday logs of strangers, each as some tool writes it: `new` reads them as they were driven, or the check says why
not with a cure that works."""

import re

import numpy as np
import pytest

from calibration.log_check.check import check_log, load_to_check
from qcar_twin.recordings.channels import COMMANDS
from qcar_twin.recordings.first_dataset.propose import propose
from qcar_twin.recordings.formats import Table
from qcar_twin.recordings.recording import RecordingError
from tests.faults.falsities import NAMES
from tests.faults.test_everyday import DEG, DRIVEN, LOST, TIME, read, text, values
from tests.faults.wander import RATE, Array

MPH, GEAR, RADIUS = 0.44704, 0.0953668, 0.033
STAMP = 1759663727.0 + TIME
YAW = DRIVEN["pose_yaw"]


def named(**names: str) -> dict[str, str]:
  return {**NAMES, **names}


def stamped(head: str, stamps: list[str], rows: list[str]) -> list[str]:
  """The clock's column of a log replaced."""
  cells = [head, *stamps]
  return [",".join((cell, line.split(",", 1)[1])) for cell, line in zip(cells, rows, strict=True)]


def topics() -> list[str]:
  """`rostopic echo -p`: one stamp in ns, dotted names, a quaternion."""
  names = {
    "motor_voltage": "field.motor.volts", "steering_command": "field.drive.steering_angle",
    "speed": "field.twist.twist.linear.x", "accel_x": "field.imu.linear_acceleration.x",
    "accel_y": "field.imu.linear_acceleration.y", "yaw_rate": "field.imu.angular_velocity.z",
    "pose_x": "field.pose.pose.position.x", "pose_y": "field.pose.pose.position.y",
    "pose_yaw": "field.pose.pose.orientation.x", "y": "field.pose.pose.orientation.y",
    "z": "field.pose.pose.orientation.z", "w": "field.pose.pose.orientation.w",
  }  # fmt: skip
  flat = np.zeros(TIME.size)
  rows = text(names=names, pose_yaw=flat, y=flat, z=np.sin(0.5 * YAW), w=np.cos(0.5 * YAW))
  return stamped("%time", [str(round(t * 1e3) * 10**6) for t in STAMP], rows)


def apart() -> list[str]:
  """A stamp's seconds and nanoseconds in two columns."""
  stamps = [f"{int(t)},{round(t % 1.0 * 1e3) * 10**6}" for t in np.round(STAMP, 3)]
  return stamped("header.stamp.secs,header.stamp.nsecs", stamps, text())


RIGHT = {
  "topics of ROS in text": topics,
  "seconds and nanoseconds apart": apart,
  "microseconds since the start": lambda: stamped("t_us", [str(round(t * 1e6)) for t in TIME], text()),
  "milliseconds since 1970": lambda: stamped("timestamp_ms", [str(round(t * 1e3)) for t in STAMP], text()),
  "steps from row to row": lambda: stamped("dt", [f"{1.0 / RATE:.6f}"] * TIME.size, text()),
  "miles per hour, unnamed": lambda: text(speed=DRIVEN["speed"] / MPH),
  "miles per hour": lambda: text(names=named(speed="Speed (mph)"), speed=DRIVEN["speed"] / MPH),
  "knots, unnamed": lambda: text(speed=DRIVEN["speed"] * 3600.0 / 1852.0),
  "a compass's heading, places east and north": lambda: text(
    names=named(pose_x="east", pose_y="north"), pose_yaw=np.mod(90.0 - DEG * YAW, 360.0)
  ),
  "degrees without a gyro": lambda: text(names=named(yaw_rate="w_raw_counts_unused"), pose_yaw=DEG * YAW),
  "a gyro in rad/s that is called one in deg/s": lambda: text(names=named(yaw_rate="gyro_z [deg/s]")),
  "the driver's wheel in degrees, 15 of them to one": lambda: text(
    names=named(steering_command="steering_wheel_angle_deg"), steering_command=15.0 * DEG * DRIVEN["steering_command"]
  ),
  "pulses for servo and speed controller": lambda: text(
    names=named(steering_command="steering_pwm_us"), steering_command=1500.0 - 800.0 * DRIVEN["steering_command"]
  ),
  "commands in per cent": lambda: text(
    names=named(steering_command="Steering(%)", motor_voltage="Spare (%)"),
    steering_command=50.0 + 80.0 * DRIVEN["steering_command"],
  ),
  "accelerations in g": lambda: text(accel_x=DRIVEN["accel_x"] / 9.80665, accel_y=DRIVEN["accel_y"] / 9.80665),
  "a gyro in deg/s with an offset": lambda: text(names=named(yaw_rate="gyro_z_dps"), yaw_rate=DEG * DRIVEN["yaw_rate"]),
}
_CUTS = 2  # samples of a command at the ends of parts, which are the last before
NOT_TOLD = {
  "commands in per cent": ("motor_voltage",),
  "degrees without a gyro": ("yaw_rate",),
}


@pytest.mark.parametrize("name", RIGHT)
def test_it_is_read_as_it_was_driven(tmp_path, name):
  check = read(tmp_path, RIGHT[name]())
  assert not check.of("spoils"), check.verdict
  for channel, driven in DRIVEN.items():
    if channel in NOT_TOLD.get(name, ()):
      continue
    time, value = values(check, channel)
    assert time - time[0] == pytest.approx(TIME, abs=1e-4), channel
    share = 0.05 if channel == "steering_command" else 2e-5  # its scale is fitted where nobody said it
    off = value - driven
    if channel == "pose_yaw":  # up to whole turns
      off -= 2.0 * np.pi * np.round(off[0] / (2.0 * np.pi))
    off = np.sort(np.abs(off))[:-_CUTS] if channel in COMMANDS else np.abs(off)
    assert off.max() < share * max(1.0, np.abs(driven).max()), channel


def test_a_wheels_turns_per_minute_are_a_motors_by_the_gear(tmp_path):
  names = named(speed="wheel_rpm")
  check = read(tmp_path, text(names=names, speed=DRIVEN["speed"] / RADIUS * 60.0 / (2.0 * np.pi)))
  assert not check.of("spoils")
  _, value = values(check, "motor_speed")
  assert value * GEAR * RADIUS == pytest.approx(DRIVEN["speed"], abs=1e-4)


def stuck(channel: str) -> Array:
  """A sensor that keeps its value for some seconds."""
  held = DRIVEN[channel][np.flatnonzero(LOST)[0]]
  return np.where(LOST, held, DRIVEN[channel])


@pytest.mark.parametrize("channel", ["speed", "yaw_rate", "accel_y", "pose_x", "pose_yaw", "steering_command"])
def test_a_sensor_that_stuck_for_seconds_is_named(tmp_path, channel):
  (tmp_path / "stuck").mkdir()
  sound = {f.text for f in read(tmp_path, text()).of("beware")}
  said = [f.text for f in read(tmp_path / "stuck", text(**{channel: stuck(channel)})).of("beware")]
  said = [one for one in said if one not in sound]
  assert any(channel in one or "the pose jumps" in one and channel == "pose_x" for one in said)


def test_a_clock_of_too_few_digits_is_none(tmp_path):
  """Single precision has 128 s to a step at a date's seconds."""
  stamps = [f"{t:.1f}" for t in STAMP.astype(np.float32).astype(float)]
  with pytest.raises(RecordingError, match="time"):
    read(tmp_path, stamped("time", stamps, text()))


def test_an_imu_turned_by_a_quarter_is_read_along_the_car_without_its_upright_axis(tmp_path):
  """Speeding up and going round tell it. The path goes along the heading, so that a heading is not blamed."""
  check = read(tmp_path, text(accel_x=DRIVEN["accel_y"], accel_y=-DRIVEN["accel_x"]))
  assert not check.of("spoils"), check.verdict
  for channel in ("accel_x", "accel_y", "yaw_rate", "pose_yaw"):
    slope, _ = np.polyfit(DRIVEN[channel], values(check, channel)[1], 1)
    assert slope == pytest.approx(1.0, abs=0.05), channel


def test_a_heading_that_looks_backwards_is_turned_where_the_command_says_that_the_car_drove_forwards(tmp_path):
  turned = np.mod(YAW, 2.0 * np.pi) - np.pi
  (said,) = [f.text for f in read(tmp_path, text(pose_yaw=turned)).of("spoils")]
  assert "scale = -1" not in said and said.endswith(
    "set offset = 3.14159 on pose_yaw in [channels], added to one that is there"
  )


DOWN = -9.81 + 0.1 * np.random.default_rng(7).standard_normal(TIME.size)
AIRCRAFT = {
  name: -DRIVEN[name] for name in ("steering_command", "accel_y", "yaw_rate", "pose_y", "pose_yaw")
}  # y right, z down


NOISE = 0.1 * np.random.default_rng(8).standard_normal((2, TIME.size))
IMU = named(accel_x="acc_x", accel_y="acc_y", acc_z="acc_z", yaw_rate="gyro_z", gyro_x="gyro_x", gyro_y="gyro_y")
LEFT, AHEAD, TURN = (DRIVEN[name] for name in ("accel_y", "accel_x", "yaw_rate"))
LYING = {
  "aircraft's axes, and so is the place": {"acc_z": DOWN, **AIRCRAFT},
  "upside down": {"acc_z": DOWN, "accel_y": -LEFT, "yaw_rate": -TURN},
  "on its side": {"accel_y": -DOWN, "acc_z": -LEFT, "gyro_y": TURN, "yaw_rate": NOISE[0]},
  "a quarter turn to the left": {"accel_x": LEFT, "accel_y": -AHEAD, "acc_z": -DOWN},
  "against gravity": {"accel_x": -AHEAD, "accel_y": -LEFT, "acc_z": DOWN},
  "in counts": {"accel_x": AHEAD * 16384 / 9.81, "accel_y": LEFT * 16384 / 9.81, "acc_z": -DOWN * 16384 / 9.81},
}


@pytest.mark.parametrize("name", LYING)
def test_an_imu_is_read_along_the_car_however_it_lies(tmp_path, name):
  check = read(tmp_path, text(names=IMU, **{"gyro_x": NOISE[0], "gyro_y": NOISE[1], **LYING[name]}))
  assert not check.of("spoils"), check.verdict
  for channel in ("steering_command", "accel_x", "accel_y", "yaw_rate", "pose_y", "pose_yaw"):
    _, value = values(check, channel)
    slope, _ = np.polyfit(DRIVEN[channel], value, 1)
    assert slope == pytest.approx(1.0, abs=0.05), channel


@pytest.mark.parametrize("axis", [{"acc_z": DOWN}, {}], ids=["by gravity", "unsaid"])
def test_an_imu_that_alone_turns_the_other_way_lies_upside_down(tmp_path, axis):
  """Heading and steering say so, where no axis was logged ahead, and nobody is asked."""
  mirrored = {name: AIRCRAFT[name] for name in ("accel_y", "yaw_rate")}
  names = named(accel_x="counts_unused", **{name: name for name in axis})
  check = read(tmp_path, text(names=names, **axis, **mirrored))
  assert not check.of("spoils"), check.verdict
  for channel in ("steering_command", "yaw_rate", "accel_y", "pose_y", "pose_yaw"):
    _, value = values(check, channel)
    assert np.corrcoef(value, DRIVEN[channel])[0, 1] > 0.99, channel


def test_a_z_that_points_down_is_asked_about_where_no_axis_was_logged_ahead(tmp_path):
  """Nothing else tells a log of aircraft's axes from one of a mirrored car."""
  with pytest.raises(RecordingError, match="left positive in this log") as caught:
    read(tmp_path, text(names=named(acc_z="acc_z", accel_x="counts_unused"), acc_z=DOWN, **AIRCRAFT))
  sides = re.search(r"scale and offset of (.*?) by -1", str(caught.value))[1].split(", ")
  check = _answered(tmp_path, lambda line: _turned(line, sides))
  assert not check.of("spoils"), check.verdict
  for channel in ("steering_command", "yaw_rate", "accel_y", "pose_yaw"):
    _, value = values(check, channel)
    assert np.corrcoef(value, DRIVEN[channel])[0, 1] > 0.99, channel


def _answered(folder, corrected=lambda line: line):
  """Checked again after a person has corrected the draft's lines and deleted its question."""
  draft = (folder / "dataset.toml").read_text(encoding="utf-8")
  kept = [corrected(line) for line in draft.splitlines() if not line.startswith("undecided")]
  (folder / "dataset.toml").write_text("\n".join(kept), encoding="utf-8")
  return check_log(load_to_check(folder))


def _turned(line: str, sides: list[str]) -> str:
  """A channel's line with the other sign."""
  if line.split(" = ")[0] not in sides:
    return line
  line = re.sub(r"(scale|offset) = (-?[\d.e-]+)", lambda m: f"{m[1]} = {-float(m[2])}", line)
  return (
    line if "scale = " in line else line.replace('",', '", scale = -1.0,', 1).replace('" }', '", scale = -1.0 }', 1)
  )


@pytest.mark.parametrize(
  ("channel", "off"),
  [("yaw_rate", 0.09), ("accel_x", 1.66)],
  ids=["a gyro by 5 deg/s", "an accelerometer tilted by 10 deg"],
)
def test_a_zero_that_is_far_off_is_said_and_the_cure_mends_it(tmp_path, channel, off):
  said = [
    f.text for f in read(tmp_path, text(**{channel: DRIVEN[channel] + off})).of("beware") if "its zero is off" in f.text
  ]
  assert len(said) == 1 and said[0].startswith(channel)
  by = float(re.search(r"set offset = (-?[\d.]+)", said[0])[1])
  assert by == pytest.approx(-off, abs=0.02)


GERMAN = {
  "motor_voltage": "Spannung [V]", "steering_command": "Lenkwinkel [°]", "speed": "Geschwindigkeit [km/h]",
  "accel_x": "Längsbeschleunigung [g]", "accel_y": "Querbeschleunigung [g]", "yaw_rate": "Gierrate [°/s]",
}  # fmt: skip


def test_units_in_brackets_are_read_in_any_language(tmp_path):
  own = {"steering_command": DEG, "speed": 3.6, "accel_x": 1 / 9.80665, "accel_y": 1 / 9.80665, "yaw_rate": DEG}
  changed = {name: factor * DRIVEN[name] for name, factor in own.items()}
  check = read(tmp_path, text(names=named(**GERMAN), **changed))
  assert not check.of("spoils"), check.verdict
  for channel in GERMAN:
    _, value = values(check, channel)
    assert np.sort(np.abs(value - DRIVEN[channel]))[-3] < 1e-4 * max(1.0, np.abs(DRIVEN[channel]).max()), channel


def test_half_a_place_is_none_and_a_brake_that_was_used_is_said(tmp_path):
  brake = np.clip(-DRIVEN["accel_x"], 0.0, 1.0)
  read(tmp_path, text(names=named(pose_y="height", brake="brake"), brake=brake))
  draft = (tmp_path / "dataset.toml").read_text(encoding="utf-8")
  assert "pose_x" not in draft.partition("# columns that are not used")[0]
  assert re.search(
    r"# 'brake' is pressed in \d+ % of its rows, and no channel is a brake: cut those seconds out", draft
  )


def test_a_place_with_y_upwards_lies_in_z_and_x(tmp_path):
  rows = {"pose_x": DRIVEN["pose_y"], "pose_y": 0.1 + 0.001 * NOISE[0], "z": DRIVEN["pose_x"]}
  names = named(pose_x="Position X (m)", pose_y="Position Y (m)", z="Position Z (m)")
  check = read(tmp_path, text(names=names, **rows))
  assert not check.of("spoils"), check.verdict
  for channel in ("pose_x", "pose_y"):
    assert values(check, channel)[1] == pytest.approx(DRIVEN[channel], abs=1e-4)


def test_files_with_a_part_of_the_channels_each_are_to_be_joined(tmp_path):
  own = {"time": TIME, "throttle": DRIVEN["motor_voltage"]}
  others = {"time": TIME, "speed": DRIVEN["speed"], "gyro_z": DRIVEN["yaw_rate"]}
  tables = [Table("commands.csv", own, {}), Table("sensors.csv", others, {})]
  with pytest.raises(RecordingError, match="commands are in commands.csv and what the car did in sensors.csv: join"):
    propose("lab", tables)


def test_a_gyro_in_rps_counts_radians_and_a_battery_is_no_other_column_without_its_name(tmp_path):
  idle = {"erpm": 4600.0 * DRIVEN["speed"], "temp_mos": 35.0 + 0.01 * TIME, "input_voltage": 11.6 + 0.05 * NOISE[0]}
  lines = text(
    names=named(yaw_rate="yaw_rate_rps", motor_voltage="duty"), motor_voltage=DRIVEN["motor_voltage"] / 12.0, **idle
  )
  _, rate = values(check := read(tmp_path, lines), "yaw_rate")
  assert rate == pytest.approx(DRIVEN["yaw_rate"], abs=1e-5)
  _, battery = values(check, "battery_voltage")
  assert np.median(battery) == pytest.approx(11.6, abs=0.01)
