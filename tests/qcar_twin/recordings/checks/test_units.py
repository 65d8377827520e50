"""What a loader must notice: wrong units and signs."""

import numpy as np
import pytest

from qcar_twin.recordings.checks.faults import find_defects
from qcar_twin.recordings.checks.units import check_limits, check_units, compare, without_spikes
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from tests.qcar_twin.recordings.drives import VEHICLE, drive, folder_with, recording, write_csv, write_manifest
from tests.qcar_twin.recordings.loading import refused_run, warned

WRONG_UNITS = [
  (
    "steering_command",
    180.0 / np.pi,
    "steering_command reaches",
    "is it in degrees? set scale = 0.0174533 on steering_command",
  ),
  ("yaw_rate", 180.0 / np.pi, "yaw_rate reaches", "is it in deg/s? set scale = 0.0174533 on yaw_rate"),
  ("accel_x", 1 / 9.80665, "accel_x is 0.1", "is it in g? set scale = 9.80665 on accel_x"),
  ("accel_y", 1 / 9.80665, "accel_y is 0.1", "is it in g? set scale = 9.80665 on accel_y"),
  ("accel_y", 1000 / 9.80665, "accel_y", "is it in mg? set scale = 0.00980665 on accel_y"),
  ("motor_speed", 60 / (2 * np.pi), "motor_speed is 9.5", "is it in rpm? set scale = 0.10472 on motor_speed"),
  ("motor_voltage", 1000.0, "motor_voltage reaches", "is it in mV? set scale = 0.001 on motor_voltage"),
  ("pose_yaw", 180.0 / np.pi, "yaw_rate is 0.017", "is it in degrees? set scale = 0.0174533 on pose_yaw"),
]


@pytest.mark.parametrize(
  "channel, factor, complaint, cure", WRONG_UNITS, ids=[f"{row[0]} x {row[1]:.3g}" for row in WRONG_UNITS]
)
def test_wrong_units_are_named_with_the_scale_that_mends_them(tmp_path, channel, factor, complaint, cure):
  time, columns = drive()
  columns[channel] = columns[channel] * factor
  refused_run(tmp_path, time, columns, complaint, "implausible", cure)
  mended = f'{channel} = {{ column = "{channel}", scale = {1 / factor} }}'
  assert warned(tmp_path, time, columns, channels=mended) == ()


def test_positions_in_millimetres(tmp_path):
  time, columns = drive()
  columns |= {"pose_x": 1000.0 * columns["pose_x"], "pose_y": 1000.0 * columns["pose_y"]}
  refused_run(tmp_path, time, columns, "is it in mm? set scale = 0.001 on pose_x and on pose_y in [channels]")


@pytest.mark.parametrize("factor, unit", [(3.6, "km/h"), (100.0, "cm/s"), (1000.0, "mm/s")])
def test_speed_in_other_units(tmp_path, factor, unit):
  time, columns = drive()
  columns["speed"] = columns.pop("motor_speed") * VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"] * factor
  refused_run(tmp_path, time, columns, "speed", f"is it in {unit}? set scale = ")


def test_small_yaw_rates_in_degrees_are_found_by_steering_alone(tmp_path):
  time, columns = drive()
  columns = {key: columns[key] for key in ("motor_voltage", "steering_command", "motor_speed", "yaw_rate")}
  columns["steering_command"] = 0.1 * columns["steering_command"]
  columns["yaw_rate"] = 0.1 * columns["yaw_rate"] * 180.0 / np.pi
  assert np.abs(columns["yaw_rate"]).max() < 15.0
  refused_run(tmp_path, time, columns, "yaw_rate is 5", "times motor_speed x steering / wheelbase", "is it in deg/s?")


def test_motor_speed_in_rpm_and_acceleration_in_g_look_alike_without_a_pose_so_both_are_named(tmp_path):
  time, columns = drive()
  columns = {key: columns[key] for key in ("motor_voltage", "motor_speed", "accel_x")}
  columns["motor_speed"] = columns["motor_speed"] * 60 / (2 * np.pi)
  refused_run(
    tmp_path,
    time,
    columns,
    "is it in g? set scale = 9.80665 on accel_x",
    "or is it in rpm? set scale = 0.10472 on motor_speed",
  )


def test_a_gyro_that_was_scaled_twice_is_said_where_the_other_sensors_agree_with_the_heading(tmp_path):
  time, columns = drive()
  columns["yaw_rate"] = np.radians(columns["yaw_rate"])
  cure = "is it in rad/s already? set scale = 57.2958 on yaw_rate in [channels]"
  refused_run(tmp_path, time, columns, "yaw_rate is 0.017", "times the change of pose_yaw, implausible; " + cure)


def test_a_heading_in_degrees_is_said_where_the_other_sensors_agree_with_the_gyro(tmp_path):
  time, columns = drive()
  columns["pose_yaw"] = np.degrees(columns["pose_yaw"])
  refused_run(tmp_path, time, columns, "is it in degrees? set scale = 0.0174533 on pose_yaw in [channels]")


def test_one_file_on_a_clock_of_milliseconds_is_no_matter_of_channels(tmp_path):
  for seed, name in enumerate(("one", "two", "three")):
    time, columns = drive(seed=seed)
    write_csv(tmp_path / f"{name}.csv", time * (1e3 if name == "two" else 1.0), columns)
  write_manifest(tmp_path, files=("one.csv", "two.csv", "three.csv"))
  with pytest.raises(
    RecordingError, match="two.csv: time steps by 10.* and 2 of the other 2 files agree: correct this"
  ):
    DataSet.load(tmp_path)


@pytest.mark.parametrize(("factor", "said"), [(180.0 / np.pi, "reaches"), (np.pi / 180.0, "is 0.017")])
def test_one_file_in_another_unit_than_the_others_is_no_matter_of_channels(tmp_path, factor, said):
  for seed, name in enumerate(("one", "two", "three")):
    time, columns = drive(seed=seed)
    columns["yaw_rate"] *= factor if name == "two" else 1.0
    write_csv(tmp_path / f"{name}.csv", time, columns)
  write_manifest(tmp_path, files=("one.csv", "two.csv", "three.csv"))
  with pytest.raises(RecordingError) as caught:
    DataSet.load(tmp_path)
  text = "and 2 of the other 2 files agree: correct this file's column, or leave the file out"
  assert str(caught.value).startswith(f"two.csv: yaw_rate {said}") and str(caught.value).endswith(text)


def test_parts_of_one_file_are_no_other_files_that_agree(tmp_path):
  time, columns = drive(30.0)
  columns["yaw_rate"][time > 20.0] *= 180.0 / np.pi
  write_csv(tmp_path / "one.csv", time, columns)
  write_manifest(tmp_path, files=("one.csv",))
  path = tmp_path / "dataset.toml"
  parts = "".join(
    f'[[recording]]\nfile = "one.csv"\nrole = "identify"\nfrom = {k}.0\nto = {k + 10}.0\n' for k in (0, 10, 20)
  )
  path.write_text(path.read_text(encoding="utf-8").partition("[[recording]]")[0] + parts, encoding="utf-8")
  with pytest.raises(RecordingError, match="one.csv: yaw_rate reaches") as caught:
    DataSet.load(tmp_path)
  assert "other" not in str(caught.value)


def test_a_wrapped_heading_in_degrees_is_found_before_it_is_unwrapped(tmp_path):
  time, columns = drive()
  columns["pose_yaw"] = (200.0 * time) % 360.0
  refused_run(
    tmp_path,
    time,
    columns,
    "pose_yaw jumps by",
    "in degrees? set scale = 0.0174533",
    channels='pose_yaw = { column = "pose_yaw", wrap = true }',
  )


def test_a_spike_beyond_the_limit_is_no_unit(tmp_path):
  time, columns = drive()
  columns["yaw_rate"][[100, 700]] = 40.0
  (note,) = warned(tmp_path, time, columns)
  said = "yaw_rate reaches 40 rad/s in 2 samples (first at 1 s), which no car does: a bad reading, or a counter that"
  assert note == f"run.csv: {said} wrapped; left out"
  (run,) = DataSet.load(tmp_path).recordings
  assert len(run["yaw_rate"]) == time.size - 2 and np.abs(run["yaw_rate"].value).max() < 15.0


def test_a_car_that_just_passes_a_limit_keeps_its_fastest_samples():
  time = 0.01 * np.arange(1000)
  speed = 30.02 * np.sin(0.5 * np.pi * time / time[-1])
  run = Recording("a", {"motor_voltage": Stream(time, speed), "speed": Stream(time, speed)})
  assert (speed > 30.0).any()
  kept, notes = without_spikes(run, {"cg_to_front": 0.1, "cg_to_rear": 0.1})
  assert notes == [] and (kept["speed"].value == speed).all()


@pytest.mark.parametrize("seed", range(60))
def test_a_mutilated_csv_is_loaded_or_refused_but_never_crashes(tmp_path, seed):
  random = np.random.default_rng(seed)
  folder = folder_with(tmp_path, *drive(0.5))
  content = bytearray((folder / "run.csv").read_bytes())
  for _ in range(random.integers(1, 6)):
    place = int(random.integers(len(content)))
    piece = [b",", b"\n", b"nan", b"inf", b"-", b"1e400", b'"', b"\r", b"\xff", b",,,", b"9", b"e"][random.integers(12)]
    content[place : place + int(random.integers(0, 30))] = piece
  (folder / "run.csv").write_bytes(content)
  try:
    assert all(run.commands(0.01)[1].shape[1] == 2 for run in DataSet.load(folder).recordings)
  except RecordingError as error:
    assert str(error).startswith("run.csv: ")


def test_a_limit_says_when_it_was_first_exceeded():
  run = Recording("a", {"motor_voltage": Stream([0.0, 0.5, 1.0], [1.0, 2.0, 2000.0]), "speed": Stream([0.0], [0.0])})
  with pytest.raises(
    RecordingError, match=r"a: motor_voltage reaches 2000 V, implausible above 100 V \(first at 1 s\)"
  ):
    check_limits(run)


def test_right_units_give_slopes_of_one():
  slopes = {f"{c.channel} / {c.witness}": c.slope() for c in compare(recording(seconds=30.0), VEHICLE)}
  assert len(slopes) == 5
  for name, (slope, correlation) in slopes.items():
    assert slope == pytest.approx(1.0, abs=0.1), name
    assert correlation > 0.9


@pytest.mark.parametrize("seed", range(5))
def test_ordinary_errors_of_sensors_are_no_units(seed):
  """Biases, scale errors up to 40 %, heavy noise: wrong, but not a wrong unit."""
  random = np.random.default_rng(seed)
  time, columns = drive(seed=seed)
  for channel, noise in (("accel_x", 1.5), ("accel_y", 1.5), ("yaw_rate", 0.1), ("motor_speed", 5.0)):
    columns[channel] = (
      columns[channel] * random.uniform(0.6, 1.4) + noise * random.standard_normal(time.size) + random.normal() * noise
    )
  run = Recording.from_columns("a", time, columns)
  check_limits(run)
  assert check_units(run, VEHICLE) == []


@pytest.mark.parametrize("channel", ["yaw_rate", "accel_y", "pose_yaw"])
def test_a_turned_sign_is_a_warning_with_the_convention(tmp_path, channel):
  time, columns = drive()
  columns[channel] = -columns[channel]
  notes = warned(tmp_path, time, columns)
  assert notes and all(
    "runs against" in note and "set scale = -1 on the channel that differs" in note for note in notes
  )


def test_nothing_is_concluded_from_standing_still():
  time = np.arange(0.0, 10.0, 0.01)
  noise = np.random.default_rng(0).normal(size=(6, time.size))
  columns = {
    "motor_voltage": 0 * time,
    "steering_command": 0.2 * np.sin(time),
    "speed": 0 * time,
    "accel_x": 0.1 * noise[0],
  }
  columns |= {
    "accel_y": 0.1 * noise[1],
    "yaw_rate": 0.01 * noise[2],
    "pose_x": 0.001 * noise[3],
    "pose_y": 0.001 * noise[4],
    "pose_yaw": 0.001 * noise[5],
  }
  run = Recording.from_columns("a", time, columns)
  assert check_units(run, VEHICLE) == [] and find_defects(run) == []


def test_vehicle_numbers_may_be_missing():
  assert len(compare(recording(), {})) >= 3
  assert check_units(recording(), {}) == []
