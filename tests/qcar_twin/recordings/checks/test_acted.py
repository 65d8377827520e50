"""Commands that are not what acted: neutrals, released switches, a commanded speed in the measured one's place."""

import numpy as np
import pytest

from calibration.log_check import check_log
from calibration.log_check.commands import command_findings
from qcar_twin.recordings.checks.acted import idle_stretches, was_commanded
from qcar_twin.recordings.checks.neutral import drive_neutral, steering_neutral
from qcar_twin.recordings.checks.pushes import pushed_stretches
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from tests.faults.falsities import SIZES, wander
from tests.faults.thresholds import FALSE
from tests.faults.wander import RATE
from tests.qcar_twin.recordings.drives import STD, VEHICLE, folder_with, write_manifest
from tests.qcar_twin.recordings.first_dataset.test_strange_logs import log


def run(time, columns, **changes) -> Recording:
  return Recording.from_columns("run", time, columns | changes)


def released(time, columns, start, end):
  """The same drive, after a stop in which the driver kept on asking for speed."""
  shift = end - start
  stop = np.arange(time[0] + start, end, time[1] - time[0])
  at = np.searchsorted(time, start)
  spliced = {}
  for name, values in columns.items():
    still = np.full(stop.size, values[at] if name.startswith("pose") else 0.0)
    spliced[name] = np.r_[values[:at], still, values[at:]]
  driver = 5.0 + np.sin(stop)
  spliced["motor_voltage"][at : at + stop.size] = driver
  return np.r_[time[:at], stop, time[at:] + shift], spliced


@pytest.mark.parametrize("seconds", [0.01, 0.06, 0.1, 0.2, 0.3])
def test_a_log_shorter_than_any_mean_is_looked_at_like_others(seconds):
  time = np.linspace(0.0, seconds, 10)
  short = run(time, {"motor_voltage": np.full(10, 3.0), "speed": np.linspace(0.0, 1.0, 10)})
  assert idle_stretches([short], "motor_voltage") == []
  assert pushed_stretches([short], "motor_voltage") == []


@pytest.mark.parametrize("neutral", [-3.0, 1.5, 6.0])
@pytest.mark.parametrize("size", SIZES.values())
def test_the_level_under_which_the_car_stands_is_the_drives_neutral(neutral, size):
  time, columns = wander(1, size)
  neutral_there = drive_neutral([run(time, columns, motor_voltage=columns["motor_voltage"] + neutral)], "motor_voltage")
  assert neutral_there.value == pytest.approx(neutral, abs=0.02)
  assert drive_neutral([run(time, columns)], "motor_voltage") is None


def test_a_car_held_by_friction_has_its_neutral_at_nothing():
  time, columns = wander(2)
  pushed = columns["motor_voltage"] + 0.8 * (time > 1.5) * (time < 3.0)
  assert drive_neutral([run(time, columns, motor_voltage=pushed)], "motor_voltage") is None
  assert idle_stretches([run(time, columns, motor_voltage=pushed)], "motor_voltage") == []


@pytest.mark.parametrize(("start", "end"), [(3.0, 33.0), (45.0, 51.0), (45.0, 120.0)])
def test_a_released_switch_is_said_with_its_stretch_and_cutting_it_out_mends_it(tmp_path, start, end):
  time, columns = wander(3)
  time, columns = released(time, columns, start, end)
  (finding,) = command_findings([run(time, columns)])
  assert finding.channels == ("motor_voltage",) and "cut the stretches out: " in finding.text
  to, begin = (float(finding.text.split(word)[1].split()[0].rstrip(",")) for word in ("to = ", "from = "))
  assert to == pytest.approx(start, abs=0.5) and begin == pytest.approx(end, abs=0.5)
  extra = f'to = {to}\n[[recording]]\nfile = "run.csv"\nrole = "identify"\nfrom = {begin}'
  data = DataSet.load(folder_with(tmp_path, time, columns, extra=extra))
  assert command_findings(data.recordings) == [] and len(data.recordings) == 2


@pytest.mark.parametrize(("centre", "travel"), [(90.0, 100.0), (0.5, 1.0), (-2.0, 3.0)])
def test_the_command_that_goes_straight_on_is_the_steerings_neutral_unless_it_is_a_trim(centre, travel):
  time, columns = wander(4)
  neutral_there = steering_neutral([run(time, columns, steering_command=centre + travel * columns["steering_command"])])
  assert neutral_there.value == pytest.approx(centre, abs=0.02 * travel)
  assert steering_neutral([run(time, columns, steering_command=columns["steering_command"] + 0.05)]) is None
  assert steering_neutral([run(time, columns, steering_command=np.abs(columns["steering_command"]) + 0.02)]) is None


@pytest.mark.parametrize("hold", [25, 60, 150])
def test_a_commanded_speed_in_the_measured_ones_place_is_found_out_by_its_leaps(hold):
  time, columns = wander(5)
  level = np.repeat(np.random.default_rng(hold).uniform(0.5, 2.5, time.size // hold + 1), hold)[: time.size]
  stepped = run(time, columns, speed=np.where(columns["motor_voltage"] > 0.1, level, 0.0))
  assert was_commanded([stepped], "speed") == (hold > 50)  # at 50 Hz; 0.5 s evenly may be a slow sensor's
  assert not was_commanded([run(time, columns)], "speed")
  levels = 0.4 * np.round(columns["speed"] / 0.4)  # what a driver with discrete actions asks for, for however long
  assert was_commanded([run(time, columns, speed=levels)], "speed")
  coarse = np.round(columns["speed"] / 0.05) * 0.05
  assert not was_commanded([run(time, columns, speed=coarse)], "speed")
  slow = np.repeat(columns["speed"][::25], 25)[: time.size]
  assert not was_commanded([run(time, columns, speed=slow)], "speed")


@pytest.mark.parametrize(("channel", "neutral"), [("motor_voltage", 4.0), ("steering_command", 0.6)])
def test_the_cure_of_a_neutral_mends_it(tmp_path, channel, neutral):
  time, columns = wander(6)
  shifted = columns | {channel: columns[channel] + neutral}
  folder = folder_with(tmp_path, time, shifted)
  (finding,) = command_findings(DataSet.load(folder).recordings)
  said = finding.text.split("set offset = ")[1].split()[0]
  lines = [f'{name} = {{ column = "{name}" }}' for name in columns if name != channel]
  lines += ['time = { column = "time" }', f'{channel} = {{ column = "{channel}", offset = {said} }}']
  (cured,) = DataSet.load(write_manifest(tmp_path, channels="\n".join(lines))).recordings
  assert command_findings([cured]) == []
  assert cured[channel].value == pytest.approx(columns[channel], abs=0.01)


@pytest.mark.parametrize("neutral", [0.4, 0.5, 0.6])
def test_a_throttle_about_its_half_is_drafted_from_its_neutral_to_full(tmp_path, neutral):
  time, own = wander(7)
  duty = own["motor_voltage"] / 12.0
  columns = {
    "throttle": 100.0 * (neutral + (1.0 - neutral) * duty),
    "velocity": own["speed"],
    "gyro_z": own["yaw_rate"],
  }
  table, _ = log(tmp_path, time, columns)
  (read,) = {r.name.split("_")[0]: r for r in DataSet.load(tmp_path).recordings}.values()
  assert table["channels"]["motor_duty"]["column"] == "throttle"
  assert read["motor_duty"].value == pytest.approx(np.interp(read["motor_duty"].time, time, duty), abs=5e-3)


@pytest.mark.parametrize("centre", [90.0, 50.0, 0.5])
def test_a_servo_about_its_middle_is_drafted_from_straight_ahead(tmp_path, centre):
  time, own = wander(8)
  servo = centre * (1.0 + 1.2 * own["steering_command"])
  columns = {"volts": own["motor_voltage"], "servo": servo, "velocity": own["speed"], "gyro_z": own["yaw_rate"]}
  log(tmp_path, time, columns)
  for read in DataSet.load(tmp_path).recordings:
    expected = np.interp(read["steering_command"].time, time, own["steering_command"])
    assert read["steering_command"].value == pytest.approx(expected, abs=0.02)


def test_a_car_that_is_pushed_is_told_from_one_that_drives():
  time, columns = wander(3)
  assert not pushed_stretches([run(time, columns)], "motor_voltage")
  for late in (75, -20):  # commands that are seconds off are no push: the car goes on under them
    shifted = (
      np.r_[np.zeros(abs(late)), columns["motor_voltage"]][: time.size] if late > 0 else columns["motor_voltage"]
    )
    shifted = shifted if late > 0 else np.r_[columns["motor_voltage"][-late:], np.zeros(-late)]
    assert not pushed_stretches([run(time, columns, motor_voltage=shifted)], "motor_voltage")
  stop, push = np.arange(45.0, 57.0, time[1] - time[0]), np.zeros(600)
  push[250:400] = 0.8 * np.sin(np.pi * np.arange(150) / 150.0)
  at = np.searchsorted(time, 46.0)
  spliced = {n: np.r_[v[:at], push if n == "speed" else np.full(stop.size, 0.0), v[at:]] for n, v in columns.items()}
  whole = np.r_[time[:at], time[at] + np.arange(stop.size) * 0.02, time[at:] + 12.0]
  alone = {name: spliced[name] for name in ("motor_voltage", "speed", "yaw_rate", "steering_command")}
  (one,) = pushed_stretches([run(whole, alone)], "motor_voltage")
  assert (one.start, one.end) == pytest.approx((51.0, 54.0), abs=0.3)
  (said,) = [f for f in command_findings([run(whole, alone)]) if "pushed or carried" in f.text]
  assert said.severity == "beware" and "ends at to = 51." in said.text


@pytest.mark.parametrize("size", SIZES.values())
def test_a_car_that_is_pushed_while_it_rolls_is_seen_push_by_push(size):
  time, columns = FALSE["pushed while it rolls"][1](*wander(21, size))
  whole = run(time, columns)
  pushed = pushed_stretches([whole], "motor_voltage")
  assert [s.start for s in pushed] == pytest.approx([64.0, 69.0], abs=0.3)
  assert [s.end for s in pushed] == pytest.approx([64.0 + 0.8 * size**0.5, 69.0 + 0.8 * size**0.5], abs=0.3)
  (said,) = command_findings([whole])
  assert said.text.count(" s to ") == 2 and "pushed or carried" in said.text


def test_wheels_that_get_their_grip_back_are_no_push():
  """The wheels' speed rises alone: neither the accelerometer nor the path shows it."""
  time, columns = wander(21)
  _, pushed = FALSE["pushed while it rolls"][1](time, columns)
  still = (time >= 60.0) & (time < 75.0)
  slow = np.where(still, 0.4 - 0.02 * (time - 60.0), columns["speed"])
  place = {"pose_x": np.cumsum(slow) / RATE, "pose_y": 0.0 * time}
  felt = {"accel_x": np.where(still, -0.02, columns["accel_x"])}
  alone = {name: pushed[name] for name in ("motor_voltage", "speed")}
  assert pushed_stretches([run(time, alone)], "motor_voltage")
  assert not pushed_stretches([run(time, alone | felt)], "motor_voltage")
  assert not pushed_stretches([run(time, alone | place)], "motor_voltage")
  assert not pushed_stretches([run(time, alone | place | felt)], "motor_voltage")


def test_a_car_that_rolls_down_a_slope_of_two_degrees_is_no_push():
  time, columns = wander(21)
  off = (time >= 60.0) & (time < 75.0)
  speed = np.where(off, np.interp(time, [60.0, 65.0, 75.0], [0.3, 2.0, 0.3]), columns["speed"])  # 0.34 m/s^2
  alone = {"motor_voltage": np.where(off, 0.0, columns["motor_voltage"]), "speed": speed}
  assert not pushed_stretches([run(time, alone)], "motor_voltage")


def test_a_log_of_pushing_alone_spoils():
  time, columns = wander(5)
  pushed = {name: columns[name] for name in ("speed", "yaw_rate")} | {"motor_voltage": 0.0 * time}
  (said,) = command_findings([run(time, pushed)])
  assert said.severity == "spoils" and "under a motor_voltage of 0" in said.text


def test_commands_that_are_seconds_late_are_no_stretch_to_cut_out():
  time, columns = wander(6)
  ends = {name: np.r_[columns[name], np.zeros(500)] for name in ("speed", "yaw_rate", "steering_command")}
  time = np.arange(time.size + 500) * (time[1] - time[0])
  asked = {"speed_command": ends["speed"], "steering_command": ends["steering_command"]}
  late = {name: np.r_[np.zeros(250), values[:-250]] for name, values in asked.items()}
  own = {name: ends[name] for name in ("speed", "yaw_rate")}
  spoiling = check_log(DataSet("lab", (run(time, own | late),), VEHICLE | {"drive": "speed"}, STD)).of("spoils")
  assert spoiling and "set late = 5" in spoiling[0].text
  assert not any("cut the stretches out" in finding.text for finding in spoiling)
