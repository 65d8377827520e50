"""The studies behind the results: every estimator on the same readings, the controller table, the commands."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

from agents.control.controllers import load
from agents.control.model import Model
from agents.studies import estimation_report
from agents.studies import estimation_study as study
from agents.studies.estimation_report import batch_cost, online_cost
from agents.studies.tracking_study import MISMATCHED, NOMINAL, TrackingCase, run_table, table_rows
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.recording import Recording, Stream
from tests import ROOT
from tests.counting import ticking

NUMBERS = {
  name: getattr(Model.nominal().vehicle, name)
  for name in (
    "mass",
    "yaw_inertia",
    "cg_to_front",
    "cg_to_rear",
    "track_width",
    "cg_height",
    "wheel_radius",
    "gear_ratio",
  )
} | {"max_steering": 0.5236}
MODEL = Model.nominal()
CONTROLLERS = load(MODEL.car)


@pytest.fixture(scope="module")
def oval():
  return study.drive_oval(MODEL, "bicycle", CONTROLLERS["lq_cm", "tuned"], count=3, laps=1)


def test_replay_with_the_same_settings_is_the_filter_of_the_loop(oval):
  track = study.replay(oval, oval.settings)["FEKF"]
  np.testing.assert_allclose(track.position, oval.result.pose[1:, :, :2], atol=1e-12)
  np.testing.assert_allclose(track.sideslip, oval.result.sideslip_angle[1:], atol=1e-12)


def test_filter_beats_held_lidar_and_dead_reckoning(oval):
  fused = study.position_rmse(oval, study.replay(oval, oval.settings)["FEKF"])
  assert np.all(fused < 0.5 * study.position_rmse(oval, study.lidar_alone(oval)))
  assert np.median(fused) < np.median(study.position_rmse(oval, study.reckoned(oval)))
  assert np.median(fused) < 0.012


def test_sideslip_of_the_filter_beats_the_kinematic_formula_under_a_servo(oval):
  """The bicycle's servo lags: a formula fed with the command is early, the filter knows of the lag."""
  filtered = study.angle_rmse(oval, study.replay(oval, oval.settings)["FEKF"].sideslip, 4)
  formula = study.angle_rmse(oval, study.kinematic_sideslip(oval)["kinematic, commanded angle"], 4)
  assert np.all(filtered < formula)


def test_centralised_filter_is_as_good_as_the_bicycle_filter(oval):
  tracks = study.replay(oval, oval.settings)
  together, own = (np.median(study.position_rmse(oval, t)) for t in (study.central(oval), tracks["EKF_BM alone"]))
  assert together == pytest.approx(own, rel=0.25)
  assert np.all(study.mean_nees(oval, tracks["FEKF"]) > 0.0)


def test_an_estimator_without_covariance_has_no_nees(oval):
  with pytest.raises(ValueError, match="states no covariance"):
    study.mean_nees(oval, study.lidar_alone(oval))


def test_spread_is_median_and_quartiles():
  assert study.spread(np.arange(1.0, 6.0)) == "3.0 [2.0, 4.0]"


def test_rate_policy_absorbs_the_mismatch_that_loose_ff_fb_shows_and_the_table_says_so():
  """Both versions and both conditions of a controller ride in one drive; the table has a row for each."""
  conditions = [("truth", NOMINAL), ("truth", MISMATCHED)]
  families = {name: {v: CONTROLLERS[name, v] for v in ("loose", "tuned")} for name in ("ff_fb", "linear_rate")}
  table, drives = run_table(families, MODEL, "bicycle", ("c",), conditions, runs=1)

  def rmse(name, version, steering):
    return float(table[TrackingCase("c", (name, version), "bicycle", "truth", steering)].rmse[0])

  assert rmse("linear_rate", "tuned", MISMATCHED) < 1.3 * rmse("linear_rate", "tuned", NOMINAL) + 5e-4
  assert rmse("ff_fb", "loose", MISMATCHED) > 1.2 * rmse("ff_fb", "loose", NOMINAL)
  rows = table_rows(table)
  assert len(rows) == 2 + 8 and set(drives) == set(table)
  assert rows[0].count("|") == rows[1].count("|") == rows[2].count("|")
  tuned = next(row for row in rows if row.startswith("| linear_rate tuned | truth | N |"))
  assert tuned.endswith("| 1 of 1 |")


def test_a_block_of_cars_drives_as_each_would_alone():
  case = TrackingCase("s", ("lq_cm", "tuned"), "bicycle", "truth", MISMATCHED)
  both = {v: CONTROLLERS["lq_cm", v] for v in ("loose", "tuned")}
  table, _ = run_table({"lq_cm": both}, MODEL, "bicycle", ("s",), [("truth", NOMINAL), ("truth", MISMATCHED)], runs=1)
  alone, _ = run_table({"lq_cm": {"tuned": both["tuned"]}}, MODEL, "bicycle", ("s",), [("truth", MISMATCHED)], runs=1)
  assert table[case].rmse == pytest.approx(alone[case].rmse, rel=1e-9)
  assert table[case].me == pytest.approx(alone[case].me, rel=1e-9)


def test_costs_are_per_period_and_car(monkeypatch):
  monkeypatch.setattr(estimation_report, "time", ticking())
  assert online_cost(MODEL, 5, windows=2) == pytest.approx(1.0 / 40)
  assert batch_cost(MODEL, 8, periods=10, repeats=1) == pytest.approx(1.0 / 10 / 8)


# -- commands ------------------------------------------------------------------------------------


def command(name, *arguments):
  done = subprocess.run(
    [sys.executable, "-m", "scripts", name, *map(str, arguments)],
    check=False,
    cwd=ROOT,
    env={
      "PYTHONPATH": str(ROOT),
      "PATH": "/usr/bin:/bin",
      "OMP_NUM_THREADS": "1",
      "MPLCONFIGDIR": str(Path(tempfile.gettempdir()) / "matplotlib"),
    },
    capture_output=True,
    text=True,
    timeout=300,
  )
  assert done.returncode == 0, done.stderr[-2000:]
  return done.stdout


def test_track_command(tmp_path):
  said = command("track", "--path", "c", "--plant", "bicycle", "--quick", "--out", tmp_path)
  assert "lq_cm tuned on c: ME" in said and "1 of 1 runs between the borders" in said
  written = json.loads((tmp_path / "kpis.json").read_text())
  assert written["kpis"]["finished"] == [True] and 0.0 < written["kpis"]["rmse"][0] < 0.02
  names = {file.name for file in tmp_path.iterdir()}
  assert names == {"kpis.json", "traces.csv", "report.html"}
  header, first = (tmp_path / "traces.csv").read_text().splitlines()[:2]
  assert header.startswith("time,pose_x") and len(first.split(",")) == len(header.split(","))


def test_estimate_command(tmp_path, oval):
  """A drive of the oval as a data set: estimates close to the truth, noise from its standstill."""
  rng = np.random.default_rng(0)
  still_time = 0.01 * np.arange(1000)
  still = {
    "yaw_rate": 0.002 + 0.01 * rng.normal(size=1000),
    "motor_voltage": np.zeros(1000),
    "motor_speed": np.zeros(1000),
  }
  still |= {"accel_x": 0.1 * rng.normal(size=1000), "accel_y": 0.1 * rng.normal(size=1000)}
  standstill = Recording("standstill", {n: Stream(still_time, v) for n, v in still.items()}, manoeuvre="standstill")
  write_dataset(tmp_path / "data", "oval", NUMBERS, {}, (standstill, drive_as_recording(oval)))
  said = command("estimate", "--dataset", tmp_path / "data", "--noise-from", "standstill", "--out", tmp_path / "out")
  assert "nominal" in said and "yaw_rate: offset 0.00" in said and "oval: valid 100.0 %" in said
  rows = np.genfromtxt(tmp_path / "out" / "oval.csv", delimiter=",", names=True)
  truth = oval.result.signals[1:, 0]
  x, y = (np.interp(rows["time"], 0.01 * np.arange(1, len(truth) + 1), truth[:, i]) for i in (0, 1))
  errors = np.hypot(rows["pose_x"] - x, rows["pose_y"] - y)
  assert np.sqrt(np.mean(errors[200:-10] ** 2)) < 0.015
  summary = json.loads((tmp_path / "out" / "summary.json").read_text())
  assert set(summary) == {"oval"} and summary["oval"]["valid"] == 1.0


def drive_as_recording(oval, car=0):
  """What the first car's sensors said, with the commands."""
  time = 0.01 * np.arange(1, len(oval.heard) + 1)
  columns = {"motor_voltage": oval.result.commands[1:, car, 0], "steering_command": oval.result.commands[1:, car, 1]}
  columns["speed"] = np.array([heard[0][car, 0] for heard in oval.heard])
  columns["yaw_rate"] = np.array([heard[0][car, 1] for heard in oval.heard])
  columns |= {
    name: np.array([heard[1][car, i] for heard in oval.heard]) for i, name in enumerate(("accel_x", "accel_y"))
  }
  fixes = [(0.01 * (k + 1 - heard[3]), heard[2][car]) for k, heard in enumerate(oval.heard) if heard[2] is not None]
  fixes = [(stamp, fix) for stamp, fix in fixes if np.isfinite(fix[0]) and stamp > 0.0]
  streams = {n: Stream(time[np.isfinite(v)], v[np.isfinite(v)]) for n, v in columns.items()}
  for i, name in enumerate(("pose_x", "pose_y", "pose_yaw", "pose_score")):
    streams[name] = Stream(np.array([stamp for stamp, _ in fixes]), np.array([fix[i] for _, fix in fixes]))
  return Recording("oval", streams, manoeuvre="oval")
