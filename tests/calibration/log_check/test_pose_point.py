"""A pose of another point than the centre of gravity is told by how it moves sideways in turns."""

import re

import numpy as np
import pytest

from calibration.log_check.pose_point import mirrored_findings, pose_point_findings
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording, Stream
from qcar_twin.vehicle.vehicle import Vehicle
from tests.qcar_twin.recordings.drives import drive

CAR = Vehicle.load()
MEASURED = (
  "mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius", "gear_ratio",
  "max_steering",
)  # fmt: skip
DATASET = """
name = "one"
[vehicle]
{numbers}
[channels]
time = {{ column = "time" }}
motor_voltage = {{ column = "motor_voltage" }}
steering_command = {{ column = "steering_command" }}
motor_speed = {{ column = "motor_speed" }}
pose_x = {{ column = "pose_x", {cure} }}
pose_y = {{ column = "pose_y" }}
pose_yaw = {{ column = "pose_yaw" }}
[[recording]]
file = "run.csv"
role = "identify"
"""


def driven(ahead, slip=0.0, seconds=80.0):
  """A drive whose pose is of a point `ahead` of the centre of gravity, m; rear tyres slip by `slip` v r, rad."""
  time, columns = drive(seconds)
  speed = columns["motor_speed"] * CAR.gear_ratio * CAR.wheel_radius
  rate = np.gradient(columns["pose_yaw"], time)
  yaw = columns["pose_yaw"]
  sideways = -slip * speed**2 * rate  # of the rear axle
  x = np.cumsum(speed * np.cos(yaw) - sideways * np.sin(yaw)) * 0.01 + (CAR.cg_to_rear + ahead) * np.cos(yaw)
  y = np.cumsum(speed * np.sin(yaw) + sideways * np.cos(yaw)) * 0.01 + (CAR.cg_to_rear + ahead) * np.sin(yaw)
  return Recording.from_columns("run", time, columns | {"pose_x": x, "pose_y": y})


@pytest.mark.parametrize("slip", [0.0, 0.02])
@pytest.mark.parametrize(("ahead", "said"), [(0.15, "ahead of"), (-0.128, "behind")])
def test_a_marker_far_from_the_centre_is_told(ahead, said, slip):
  (finding,) = pose_point_findings([driven(ahead, slip)], CAR)
  assert f"m {said} the centre of gravity" in finding.text
  measured = float(finding.text.partition("of a point ")[2].split()[0])
  assert measured == pytest.approx(abs(ahead), abs=0.012)


def test_the_cure_followed_as_it_is_written_leaves_nothing_to_say(tmp_path):
  run = driven(0.15)
  (finding,) = pose_point_findings([run], CAR)
  (cure,) = re.findall(r"set (ahead = [-0-9.]+) on pose_x in \[channels\]", finding.text)
  columns = {"time": run["pose_x"].time} | {name: run[name].value for name in run.channels}
  rows = np.column_stack(list(columns.values()))
  np.savetxt(tmp_path / "run.csv", rows, "%.9g", ",", header=",".join(columns), comments="")
  manifest = DATASET.format(cure=cure, numbers="\n".join(f"{name} = {getattr(CAR, name)}" for name in MEASURED))
  (tmp_path / "dataset.toml").write_text(manifest, encoding="utf-8")
  (moved,) = DataSet.load(tmp_path).recordings
  assert pose_point_findings([moved], CAR) == []
  middle = len(run["pose_x"]) // 2
  off = np.hypot(*(moved[n].value[middle] - run[n].value[middle] for n in ("pose_x", "pose_y")))
  assert off == pytest.approx(abs(float(cure.split()[-1])))


@pytest.mark.parametrize("ahead", [-0.03, 0.0, 0.03])
def test_one_near_it_is_not(ahead):
  assert pose_point_findings([driven(ahead)], CAR) == []


def test_straight_driving_and_short_logs_tell_nothing():
  assert pose_point_findings([driven(0.15).window(0.0, 20.0)], CAR) == []
  time = np.arange(0.0, 60.0, 0.01)
  noise = 0.004 * np.random.default_rng(3).standard_normal((3, 6000))
  columns = {"motor_speed": np.full(6000, 300.0), "pose_x": time + noise[0], "pose_y": noise[1], "pose_yaw": noise[2]}
  assert pose_point_findings([Recording.from_columns("run", time, columns)], CAR) == []


def test_a_heading_that_points_askew_is_told_with_its_cure():
  def askew(by):
    run = driven(0.1)
    turned = Stream(run["pose_yaw"].time, run["pose_yaw"].value + by)
    return pose_point_findings([run.replace(streams={**run.streams, "pose_yaw": turned})], Vehicle())

  (found,) = askew(0.6)
  assert found.channels == ("pose_yaw",) and "to the left of where the car goes straight on" in found.text
  (by,) = map(float, re.findall(r"set offset = (-?[\d.]+) on pose_yaw", found.text))
  assert by == pytest.approx(-0.6, abs=0.03)
  assert all(f.channels != ("pose_yaw",) for f in askew(0.05))


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_path_that_turns_to_the_other_side_than_the_gyro_is_told(mirrored):
  """Without a heading, as from satellites: nothing else tells a place of the other hand."""
  run = driven(0.1)
  streams = {name: run[name] for name in ("pose_x", "pose_y")} | {"yaw_rate": _rate(run["pose_yaw"])}
  if mirrored:
    streams["pose_y"] = Stream(run["pose_y"].time, -run["pose_y"].value)
  said = [f.text for f in mirrored_findings([run.replace(streams=streams)])]
  assert len(said) == mirrored and all("set scale = -1 on pose_y where the place is mirrored" in text for text in said)


def test_a_steady_turn_without_noise_says_nothing_of_signs():
  """As of a simulation: neither of the two varies, so that no correlation tells whether they agree."""
  time = np.arange(0.0, 60.0, 1.0 / 128.0)
  values = {
    "pose_x": 2.0 * np.sin(0.5 * time),
    "pose_y": -2.0 * np.cos(0.5 * time),
    "yaw_rate": np.full(len(time), 0.5),
  }
  assert mirrored_findings([Recording("r", {name: Stream(time, value) for name, value in values.items()})]) == []


def _rate(heading):
  return Stream(heading.time, np.gradient(heading.value, heading.time))
