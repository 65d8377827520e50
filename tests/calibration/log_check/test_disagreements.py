"""Two sensors of one motion that do not agree: it spoils a fit, with the cure that makes them agree."""

import numpy as np
import pytest

from calibration.log_check import check_log
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream
from tests.calibration.log_check.test_pairs import changed, drives
from tests.faults.falsities import wander
from tests.qcar_twin.recordings.drives import STD, VEHICLE, drive


def lab(runs: list[Recording], **vehicle: float) -> DataSet:
  return DataSet("lab", tuple(runs), VEHICLE | vehicle, STD)


def rewritten(run: Recording, **values) -> Recording:
  streams = {name: Stream(run[name].time, value) for name, value in values.items()}
  return run.replace(streams={**run.streams, **streams})


def spoiling(runs: list[Recording], **vehicle: float) -> list[str]:
  return [f.text for f in check_log(lab(runs, **vehicle)).of("spoils")]


@pytest.mark.parametrize("late", [0.8, 1.5, 3.0])
def test_a_sensor_that_is_seconds_late_is_said_with_its_lag_and_the_cure_mends_it(late):
  runs = drives(channel="accel_x", late=late)
  (text,) = spoiling(runs)
  said = float(text.split("set late = ")[1].split(" ")[0])
  assert said == pytest.approx(late, abs=0.03) and "on accel_x in [channels]" in text
  assert not spoiling([changed(r, "accel_x", late=-said) for r in runs])


def test_a_gyro_that_is_late_is_said_alone_with_its_lag_and_the_cure_mends_it():
  runs = drives(channel="yaw_rate", late=0.3)
  assert not spoiling(runs)
  (text,) = [f.text for f in check_log(lab(runs)).of("beware") if "set late" in f.text]
  said = float(text.split("set late = ")[1].split(" ")[0])
  assert said == pytest.approx(0.3, abs=0.01) and "on yaw_rate in [channels]" in text
  mended = check_log(lab([changed(r, "yaw_rate", late=-said) for r in runs]))
  assert not any("late" in f.text for f in (*mended.of("spoils"), *mended.of("beware")))


@pytest.mark.parametrize("late", [0.3, 0.0])
def test_a_speed_that_is_late_against_the_accelerometer_is_said_where_no_pose_tells(late):
  bare = [
    r.replace(streams={n: s for n, s in r.streams.items() if not n.startswith("pose")})
    for r in drives(channel="motor_speed", late=late)
  ]
  said = [f.text for f in check_log(lab(bare)).of("beware") if "set late" in f.text]
  assert len(said) == (late > 0.0)
  if said:
    assert said[0].startswith("motor_speed is 0.3") and "against accel_x: set late = 0.3" in said[0]
    mended = check_log(lab([changed(r, "motor_speed", late=-late) for r in bare]))
    assert not any("set late" in f.text for f in mended.of("beware"))


@pytest.mark.parametrize("signed", [True, False])
def test_a_motor_speed_and_a_speed_that_no_gearing_makes_one_are_said(signed):
  """Without a pose nothing but the other speed tells that the gear ratio is another car's."""
  size = (lambda v: v) if signed else np.abs
  bare = [r.replace(streams={n: s for n, s in r.streams.items() if not n.startswith("pose")}) for r in drives()]
  travel = VEHICLE["gear_ratio"] * VEHICLE["wheel_radius"]
  both = [
    r.replace(streams={**r.streams, "speed": Stream(r["motor_speed"].time, size(travel * r["motor_speed"].value))})
    for r in bare
  ]
  assert not spoiling(both)
  (text,) = spoiling(both, gear_ratio=1.8 * VEHICLE["gear_ratio"])
  assert text.startswith("motor_speed and speed differ 1.8-fold in rolling") and "correct gear_ratio" in text


def wandering(seed: int) -> Recording:
  """A drive that never repeats itself."""
  time, columns = drive(60.0, seed=seed)
  smooth = np.exp(-0.5 * (np.arange(-300, 301) / 60.0) ** 2)
  noise = np.convolve(np.random.default_rng(seed).standard_normal(time.size), smooth / np.linalg.norm(smooth), "same")
  yaw_rate, columns["speed"] = noise, 1.0 + 0.0 * time
  yaw = np.cumsum(yaw_rate) / 100.0
  columns |= {
    "steering_command": np.arctan(0.256 * yaw_rate),
    "accel_y": yaw_rate,
    "yaw_rate": yaw_rate,
    "pose_yaw": yaw,
  }
  columns |= {"pose_x": np.cumsum(np.cos(yaw)) / 100.0, "pose_y": np.cumsum(np.sin(yaw)) / 100.0}
  del columns["motor_speed"], columns["accel_x"]
  return Recording.from_columns(f"run_{seed}", time, columns)


def hurried(run: Recording) -> Recording:
  """The same curves at a speed that changes."""
  time = run["speed"].time
  speed = 1.0 + 0.5 * np.sin(1.3 * time)
  yaw_rate = speed * run["yaw_rate"].value
  yaw = np.cumsum(yaw_rate) / 100.0
  x, y = (np.cumsum(speed * way) / 100.0 for way in (np.cos(yaw), np.sin(yaw)))
  turning = {"yaw_rate": yaw_rate, "accel_y": speed * yaw_rate, "pose_yaw": yaw}
  return rewritten(run, speed=speed, pose_x=x, pose_y=y, **turning)


@pytest.mark.parametrize("late", [0.8, -0.8, 2.0])
def test_commands_that_are_seconds_late_are_said_though_the_speed_they_act_on_is_not(late):
  runs = [hurried(wandering(k)) for k in range(2)]
  assert not spoiling(runs)
  runs = [changed(changed(r, "steering_command", late=late), "motor_voltage", late=late) for r in runs]
  (text,) = spoiling(runs)
  said = float(text.split("set late = ")[1].split(" ")[0])
  assert said == pytest.approx(late, abs=0.12) and "on steering_command in [channels], and on the drive's" in text
  mended = [changed(changed(r, "steering_command", late=-said), "motor_voltage", late=-said) for r in runs]
  assert not spoiling(mended)


def test_accelerations_in_g_that_are_read_in_thousandths_are_told_by_their_units():
  runs = [rewritten(r, accel_x=1e-3 * r["accel_x"].value, accel_y=1e-3 * r["accel_y"].value) for r in drives()]
  texts = spoiling(runs)
  assert texts and all("in g, read as mg? set scale = 1000 on accel_" in text for text in texts)


def test_a_lag_beyond_the_search_is_not_reported_as_one():
  assert not spoiling([wandering(k) for k in range(2)])
  runs = [changed(wandering(k), "yaw_rate", late=15.0) for k in range(2)]
  texts = spoiling(runs)
  assert texts and not any("set late = " in text for text in texts)


def test_an_accelerometer_that_does_not_feel_the_curve_spoils():
  noise = np.random.default_rng(1)
  runs = [rewritten(r, accel_y=0.1 * noise.standard_normal(len(r["accel_y"]))) for r in drives()]
  (text,) = spoiling(runs)
  assert text.startswith("accel_y and motor_speed and yaw_rate do not agree in going round") and "tried in vain" in text


def test_exchanged_axes_are_found_out_and_exchanging_them_mends_it():
  runs = [rewritten(r, accel_x=r["accel_y"].value, accel_y=r["accel_x"].value) for r in drives()]
  texts = spoiling(runs)
  assert any("exchange the columns of accel_x and accel_y in [channels]" in text for text in texts)
  assert not spoiling([rewritten(r, accel_x=r["accel_y"].value, accel_y=r["accel_x"].value) for r in runs])


def test_of_two_readings_that_one_motion_allows_the_one_that_mends_the_other_motion_too_is_the_cure():
  turned = [rewritten(r, accel_x=r["accel_y"].value, accel_y=-r["accel_x"].value) for r in drives()]
  texts = spoiling(turned)
  cure = (
    "exchange the columns of accel_x and accel_y in [channels], and set scale = -1 on accel_x, times one that is there"
  )
  assert len(texts) == 2 and all(text.endswith(cure) and text.count("exchange the columns") == 1 for text in texts)


def long(size):
  """Lengths of a car so many times as long."""
  return {key: size * VEHICLE[key] for key in ("cg_to_front", "cg_to_rear")}


def mirrored(columns):
  across = ("steering_command", "accel_y", "yaw_rate", "pose_y", "pose_yaw")
  return columns | {name: -columns[name] for name in across}


@pytest.mark.parametrize("signs", [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
@pytest.mark.parametrize(("seed", "size"), [(2065472076, 11.0), (3, 11.0), (4, 1.0), (5, 0.23)])
def test_exchanged_axes_are_found_out_in_slow_motion_too(seed, size, signs):
  time, columns = wander(seed, size)
  columns = mirrored(columns) if seed % 2 else columns
  along, across = (sign * columns[name] for sign, name in zip(signs, ("accel_y", "accel_x"), strict=True))
  wrong = Recording.from_columns("run", time, columns | {"accel_x": along, "accel_y": across})
  assert not spoiling([Recording.from_columns("run", time, columns)], **long(size))
  texts = spoiling([wrong], **long(size))
  assert texts and all("exchange the columns of accel_x and accel_y in [channels]" in text for text in texts)
  assert all("set scale = -1 on accel" in text for text in texts) or signs == (1.0, 1.0)


@pytest.mark.parametrize("channel", ["accel_x", "accel_y"])
@pytest.mark.parametrize(("seed", "size"), [(3, 11.0), (4, 1.0)])
def test_an_axis_that_stands_in_for_the_only_other_one_is_not_passed(channel, seed, size):
  time, columns = wander(seed, size)
  other = {"accel_x": "accel_y", "accel_y": "accel_x"}[channel]
  columns[channel] = columns.pop(other)
  check = check_log(lab([Recording.from_columns("run", time, columns)], **long(size)))
  assert any(channel in f.channels for f in check.of("spoils"))


def test_an_accelerometer_that_this_driving_cannot_judge_is_said_to_be_so():
  time, columns = wander(9005, 0.23)
  columns["accel_x"] = -columns.pop("accel_y")
  check = check_log(lab([Recording.from_columns("run", time, columns)], **long(0.23)))
  named = [f.text for f in (*check.of("spoils"), *check.of("beware")) if "accel_x" in f.channels]
  assert any("cannot be decided from this driving" in text for text in named)


def test_an_accelerometer_that_shakes_more_than_the_car_moves_is_no_other_channel():
  shaken = np.random.default_rng(7)
  runs = [rewritten(r, accel_x=r["accel_x"].value + 6.0 * shaken.standard_normal(len(r["accel_x"]))) for r in drives()]
  assert not spoiling(runs)


def test_a_heading_from_another_axis_is_found_out():
  runs = [rewritten(r, pose_yaw=r["pose_yaw"].value + 0.5 * np.pi) for r in drives()]
  texts = spoiling(runs)
  assert any("pose_yaw a quarter turn further right" in text and "offset = -1.5708" in text for text in texts)
  assert not spoiling([rewritten(r, pose_yaw=r["pose_yaw"].value - 0.5 * np.pi) for r in runs])


def test_a_steering_angle_that_no_wheelbase_explains_spoils():
  runs = [rewritten(r, steering_command=r["steering_command"].value / 3.7) for r in drives()]
  (text,) = spoiling(runs)
  assert "the car turns like one of wheelbase 0.0676 m" in text and "[vehicle] says 0.256 m" in text
  assert not spoiling(drives(), cg_to_front=0.14)


def test_a_frame_that_changes_for_a_while_does_not_hide_a_scale():
  runs = [changed(r, "motor_speed", scale=1.3) for r in drives()]
  heading = runs[2]["pose_yaw"]
  runs[2] = rewritten(runs[2], pose_yaw=heading.value + 1.3 * (heading.time > 24.0))
  texts = [f.text for f in check_log(lab(runs)).of("beware")]
  assert any("motor_speed reads +30" in text for text in texts)
  assert any("do not agree in driving as elsewhere" in text for text in texts)


def test_wheels_that_spin_and_a_servo_that_is_slow_are_named_where_sensors_part():
  runs = drives()
  wheels, command = runs[2]["motor_speed"], runs[1]["steering_command"]
  spun = wheels.value + np.where(np.abs(wheels.time - 12.0) < 3.0, 60.0 * np.sin(6.0 * wheels.time), 0.0)
  held = np.where(np.abs(command.time - 12.0) < 3.0, 0.5, command.value)
  runs[1:] = [rewritten(runs[1], steering_command=held), rewritten(runs[2], motor_speed=spun)]
  texts = {f.text.split(" as elsewhere")[0].split(" in ")[-1]: f.text for f in check_log(lab(runs)).of("beware")}
  for motion in ("driving", "speeding up and slowing down"):
    assert "wheels that spin or lock do that, and a fit can use it" in texts[motion]
  assert "a slow servo, or tyres that slide, do that, and a fit can use it" in texts["answering the steering"]
