"""One file among several that was logged in another way is found, and nothing where all are alike."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from calibration.fitting.noise import noise_models
from calibration.log_check import check_log
from calibration.log_check.check import LogCheck
from calibration.log_check.motions import Wheels, motions
from calibration.log_check.odd_files import TwoGroups, _odd
from calibration.log_check.pairs import compare
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.vehicle import Vehicle
from tests.faults.wander import wander
from tests.qcar_twin.recordings.drives import STD, VEHICLE

ODD = "run_2.csv"


def checked(late: float = 0.0, **scales: float) -> LogCheck:
  """Four drives, of which one has channels scaled, and its speed late, s."""
  runs = []
  for k in range(4):
    time, columns = wander(40 + k)
    odd = f"run_{k}.csv" == ODD
    columns = {name: v * (scales.get(name, 1.0) if odd else 1.0) for name, v in columns.items()}
    if odd and late:
      columns["speed"] = np.interp(time - late, time, columns["speed"])
    runs.append(Recording.from_columns(f"run_{k}", time, columns, file=f"run_{k}.csv"))
  return check_log(DataSet("lab", tuple(runs), VEHICLE, STD))


def of_two(**scales: float) -> list[str]:
  """What is said of two drives, of which the second has channels scaled."""
  runs = []
  for k in range(2):
    time, columns = wander(44 + k)
    columns = {name: v * (scales.get(name, 1.0) if k else 1.0) for name, v in columns.items()}
    runs.append(Recording.from_columns(f"run_{k}", time, columns, file=f"run_{k}.csv"))
  check = check_log(DataSet("lab", tuple(runs), VEHICLE, STD))
  return [f.text for f in check.of("spoils") if "run_1.csv than in run_0.csv" in f.text or "as in run_0.csv" in f.text]


def about_files(check: LogCheck) -> list[tuple[str, str]]:
  return [(f.severity, f.text) for f in check.findings if "the other files" in f.text]


def test_files_that_are_alike_have_no_odd_one():
  assert about_files(checked()) == []


@pytest.mark.parametrize(
  ("scales", "said"),
  [
    ({"motor_voltage": 100.0}, f"motor_voltage is 100 times as large in {ODD} as in the other files"),
    ({"motor_voltage": 0.01}, f"motor_voltage is 0.01 times as large in {ODD} as in the other files"),
    ({"steering_command": -1.0}, f"yaw_rate, or steering_command, or speed has another sign in {ODD}"),
    ({"speed": 3.6}, "the ratio of the two is 3.6"),
    ({"yaw_rate": 57.3}, "the ratio of the two is 57.3"),
  ],
)
def test_a_file_in_another_unit_or_with_another_sign_spoils_and_is_named(scales, said):
  found = about_files(checked(**scales))
  assert found and all(severity == "spoils" and ODD in text for severity, text in found)
  assert any(said in text for _, text in found)


def test_a_file_whose_speed_is_late_is_named():
  ((severity, text),) = about_files(checked(late=0.3))
  late = float(text.split("speed is ")[1].split(" ")[0])
  assert severity == "beware" and f"later in {ODD} than in the other files" in text
  assert late == pytest.approx(300.0, abs=10.0)


@pytest.mark.parametrize(("rows", "way"), [(50, "earlier"), (-50, "later")])
def test_a_file_whose_steering_has_another_clock_spoils_and_is_named(rows, way):
  """A column that was moved by a second against the rest, as in a spreadsheet."""
  runs = []
  for k in range(4):
    time, columns = wander(40 + k)
    if f"run_{k}.csv" == ODD:
      columns = columns | {"steering_command": np.roll(columns["steering_command"], rows)}
    runs.append(Recording.from_columns(f"run_{k}", time, columns, file=f"run_{k}.csv"))
  found = about_files(check_log(DataSet("lab", tuple(runs), VEHICLE, STD)))
  ((severity, text),) = [one for one in found if "answers steering_command" in one[1]]
  assert severity == "spoils" and f"s {way} in {ODD} than in the other files" in text
  assert float(text.split("steering_command ")[1].split(" ")[0]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
  ("channel", "severity", "said"),
  [
    ("yaw_rate", "spoils", f"yaw_rate reads 25 % more in {ODD} than in the other files, against pose_yaw"),
    ("speed", "beware", f"speed reads 25 % more in {ODD} than in the other files, against pose_x"),
  ],
)
def test_a_file_of_another_scale_is_named_for_a_gyro_it_spoils(channel, severity, said):
  found = about_files(checked(**{channel: 1.25}))
  assert any(one == severity and text.startswith(said) for one, text in found)
  assert all(ODD in text for _, text in found)


def test_two_files_of_two_cars_are_told_apart_and_two_of_one_are_not():
  assert of_two() == []
  (longer,) = of_two(steering_command=2.4)
  assert "or is another car's" in longer and "leave run_1.csv out: a data set is of one car" in longer
  (sign,) = of_two(steering_command=-1.0)
  assert "another sign in run_1.csv than in run_0.csv" in sign
  assert any("motor_voltage is 100 times as large in run_1.csv" in text for text in of_two(motor_voltage=100.0))


def of_four(changed: Sequence[int], **scales: float) -> LogCheck:
  """Four drives, of which some have channels scaled."""
  runs = []
  for k in range(4):
    time, columns = wander(60 + k)
    columns = {name: v * (scales.get(name, 1.0) if k in changed else 1.0) for name, v in columns.items()}
    runs.append(Recording.from_columns(f"run_{k}", time, columns, file=f"run_{k}.csv"))
  return check_log(DataSet("lab", tuple(runs), VEHICLE, STD))


def grouped(check: LogCheck) -> list[tuple[str, str]]:
  return [(f.severity, f.text) for f in check.findings if isinstance(f, TwoGroups)]


@pytest.mark.parametrize("changed", [(2, 3), (1, 3), (0, 1)])
def test_two_files_of_each_of_two_cars_are_told_apart(changed):
  ((severity, text),) = grouped(of_four(changed, steering_command=1.5, motor_voltage=1.4))
  named = [f"run_{a}.csv and run_{b}.csv" for a, b in (changed, [k for k in range(4) if k not in changed])]
  assert severity == "spoils" and all(name in text for name in named)
  turns, takes = (float(text.split(word)[1].split(" ")[0]) for word in ("turns ", "takes "))
  latter = changed if 0 not in changed else ()
  assert turns == pytest.approx(1.0 / 1.5 if latter else 1.5, rel=0.05)
  assert takes == pytest.approx(1.4 if latter else 1.0 / 1.4, rel=0.05)
  assert "two cars, or one that was changed" in text


def test_a_car_whose_steering_alone_was_changed_is_a_warning():
  ((severity, text),) = grouped(of_four((1, 3), steering_command=1.7))
  assert severity == "beware" and "turns 0.5" in text and "takes" not in text


@pytest.mark.parametrize("scales", [{}, {"motor_voltage": 1.2}, {"steering_command": 1.2}, {"motor_voltage": 1.4}])
def test_a_battery_or_a_floor_makes_no_two_cars(scales):
  assert grouped(of_four((1, 3), **scales)) == []


@pytest.mark.parametrize(("lag", "said"), [(0.1, True), (10.3, False), (-9.0, False)])
def test_a_sign_is_another_only_at_the_others_lag(lag, said):
  """Circles that change side every 10 s have the other sign half a round on, where a spin spoils the right lag."""
  time, columns = wander(40)
  run = Recording.from_columns("run", time, columns)
  wheels = Wheels.of(Vehicle.from_dataset(VEHICLE, STD), [run])
  motion = next(m for m in motions(wheels, [run]) if "steering_command" in m.reference)
  usual = compare(motion, wheels, [run], noise_models([run]))
  odd = dataclasses.replace(usual, correlation=-0.98, lag=dataclasses.replace(usual.lag, value=lag))
  findings = _odd("circles.csv", odd, [usual] * 3, "the other files", slides=False)
  assert any("another sign in circles.csv" in f.text for f in findings) == said


def checked_at_the_limit(factor: float, across: float = 0.0) -> list[tuple[str, str]]:
  """Four drives, in one of which the car turns a factor more than it steers, and feels so much on top across, m/s^2."""
  runs = []
  for k in range(4):
    time, columns = wander(40 + k)
    if f"run_{k}.csv" == ODD:
      columns = columns | {"yaw_rate": factor * columns["yaw_rate"], "accel_y": columns["accel_y"] + across}
    runs.append(Recording.from_columns(f"run_{k}", time, columns, file=f"run_{k}.csv"))
  about = [f for f in check_log(DataSet("lab", tuple(runs), VEHICLE, STD)).findings if "the other files" in f.text]
  return [(f.severity, f.text) for f in about if "answering the steering" in f.text]


def test_a_car_that_slides_turns_more_than_it_steers_and_is_no_other_car():
  """A worn rear axle at the limit turned 2.2 times as much as elsewhere; the same of a gentle drive is a scale."""
  ((severity, text),) = checked_at_the_limit(2.6)
  assert severity == "spoils" and "another unit" in text
  ((severity, text),) = checked_at_the_limit(2.6, across=6.0)
  assert severity == "beware" and "it slides there" in text
  ((severity, text),) = checked_at_the_limit(57.3, across=6.0)
  assert severity == "spoils"
