"""What tracking leaves behind: files, lines, figures, and the models it is set up from."""

import dataclasses
import json
import re

import matplotlib.image
import numpy as np
import pytest

from agents.control import controllers, figures
from agents.control.closed_loop import Actuation, Scenario, drive
from agents.control.controllers import make
from agents.control.kpis import kpis
from agents.control.model import STEERING_LAG, Model
from agents.control.output import indicator_line, write_drive, write_traces
from agents.control.page import drive_section
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.estimation.observer import TrueObserver
from qcar_twin.paths import path_named
from qcar_twin.plant import SIGNALS
from qcar_twin.plotting import contestant_colour
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.agents.control.tracking_rig import CAR, follow

LQ = make("lq_cm", {"cross_track_rate": 0.15, "heading": 0.1, "heading_rate": 1e-3, "effort": 0.03}, CAR, 0.5)


@pytest.fixture(scope="module")
def lane_change():
  return follow(LQ, "c", count=2, offset=np.array([0.0, 0.01]))


def test_a_drive_leaves_indicators_traces_and_a_page(tmp_path, lane_change):
  indicators = kpis(lane_change)
  line = write_drive(tmp_path / "new", "lq_cm tuned", lane_change, indicators, {"path": "c"})
  assert line == indicator_line("lq_cm tuned", lane_change, indicators)
  assert line.startswith("lq_cm tuned on c: ME ") and line.endswith("2 of 2 runs between the borders")
  content = json.loads((tmp_path / "new" / "kpis.json").read_text())
  assert content["config"] == {"path": "c"} and content["kpis"]["rmse"] == pytest.approx(indicators.rmse.tolist())
  assert {file.name for file in (tmp_path / "new").iterdir()} == {"kpis.json", "traces.csv", "report.html"}
  assert line in (tmp_path / "new" / "report.html").read_text(encoding="utf-8")


def test_the_page_shows_every_run_beside_the_reference(lane_change):
  explorer = drive_section(lane_change, Vehicle.load()).figures[0]
  assert [run.name for run in explorer.runs] == ["run 1", "run 2"] and len(explorer.moments) == 2
  assert [name for *_, name in explorer.guides] == ["reference", *["border"] * 2 * len(lane_change.path.lanes)]
  error = explorer.runs[1].panels[0].lines[0].value
  np.testing.assert_allclose(error, 1e3 * lane_change.cross_track[lane_change.under_way[:, 1], 1])
  worst = explorer.moments[1]
  time = explorer.runs[1].panels[0].lines[0].time
  assert np.abs(error[(time >= worst.start) & (time <= worst.end)]).max() == np.abs(error).max()


def test_a_lost_run_is_null_in_json_and_not_infinity(tmp_path, lane_change):
  lost = dataclasses.replace(lane_change, finished=np.array([True, False]))
  write_drive(tmp_path, "x", lost, kpis(lost), {})
  text = (tmp_path / "kpis.json").read_text()
  assert "Infinity" not in text and json.loads(text)["kpis"]["rmse"][1] is None


def test_what_was_commanded_is_called_by_the_cars_own_drive(tmp_path, lane_change):
  """A duty under the name of a voltage would be read as one."""
  write_drive(tmp_path, "x", lane_change, kpis(lane_change), {}, Vehicle(drive="duty"))
  header = (tmp_path / "traces.csv").read_text().partition("\n")[0].split(",")
  assert "motor_duty" in header and "motor_voltage" not in header
  panels = [panel.title for panel in drive_section(lane_change, Vehicle(drive="current")).figures[0].runs[0].panels]
  assert panels[-1] == "motor current [A]"


def test_traces_hold_signals_commands_and_estimates(tmp_path, lane_change):
  write_traces(tmp_path / "traces.csv", lane_change, car=1)
  rows = np.genfromtxt(tmp_path / "traces.csv", delimiter=",", names=True)
  assert rows.dtype.names == (
    "time",
    *SIGNALS,
    "motor_voltage",
    "steering_command",
    "estimated_x",
    "estimated_y",
    "estimated_yaw",
    "cross_track_error",
  )
  np.testing.assert_allclose(rows["pose_y"], lane_change.signals[:, 1, 1], atol=1e-5)
  np.testing.assert_allclose(rows["cross_track_error"], lane_change.cross_track[:, 1], atol=1e-6)


def test_cars_of_a_drive_can_be_picked(lane_change):
  second = lane_change.cars(slice(1, 2))
  assert second.signals.shape[1] == 1 and second.finished.shape == (1,)
  assert kpis(second).me[0] == kpis(lane_change).me[1]
  np.testing.assert_array_equal(second.cross_track[:, 0], lane_change.cross_track[:, 1])


def test_indicator_bars_are_drawn(tmp_path):
  table = {path: {"lq_cm tuned": (0.004, 0.01, 0.2), "ff_fb loose": (0.01, 0.03, 0.2)} for path in ("o", "c")}
  figures.indicator_figure(table, tmp_path / "bars.png")
  assert matplotlib.image.imread(tmp_path / "bars.png")[..., :3].std() > 0.02
  assert contestant_colour("lq_cm tuned") != contestant_colour("ff_fb loose")


# -- models --------------------------------------------------------------------------------------


def test_nominal_model_is_the_qcar_and_its_bicycle():
  model = Model.nominal()
  plant, theta = model.plant("bicycle")
  assert isinstance(plant, Bicycle) and theta.shape == (5,)
  assert float(np.asarray(model.car.rolling_radius)) == pytest.approx(
    model.vehicle.gear_ratio * model.vehicle.wheel_radius
  )


def test_twin_is_a_plant_too():
  plant, theta = Model.nominal().plant("mujoco")
  assert isinstance(plant, Twin) and theta.shape == (len(plant.parameters),)


def test_filter_is_told_what_belongs_to_the_plant():
  model = Model.nominal()
  assert {name: model.filter_settings(name).steering_lag for name in STEERING_LAG} == STEERING_LAG
  assert model.filter_settings("bicycle").front_drive_share == 0.0
  assert model.filter_settings("mujoco", sharing=(0.5, 0.5)).sharing == (0.5, 0.5)


def test_unknown_plant_lists_the_known():
  with pytest.raises(KeyError, match="no plant 'tricycle'; there are mujoco, reduced and bicycle"):
    Model.nominal().plant("tricycle")
  with pytest.raises(KeyError, match="no plant 'twin'; it is called mujoco now"):
    Model.nominal().plant("twin")


def test_a_run_that_leaves_the_path_is_said_with_how_far_it_came():
  class Straight:
    def steer(self, situation):
      return np.zeros(len(situation.speed))

  driven = follow(Straight(), "o", count=2)
  line = indicator_line("none", driven, kpis(driven))
  assert re.fullmatch(r"none on o: 2 of 2 runs did not reach the end, the first came \d\.\d m far", line)


def test_a_foreign_cars_twin_brings_the_model_of_its_own_car():
  vehicle = dataclasses.replace(Vehicle.load(), name="rear", drive="duty", layout="rear")
  twin = Twin(vehicle, threads=1).on("reduced")
  theta = twin.parameters.vector({"cornering_stiffness_rear": 90.0})
  model = Model.of_twin(twin, theta)
  assert model.filter_settings("mujoco").front_drive_share == 0.0
  assert float(np.asarray(model.car.cornering_stiffness_rear)) == 90.0
  numbers = controllers.entry("lq_cm", "tuned")
  task = Scenario(path_named("o"), 0.5, 1, lock=vehicle.max_steering, actuation=Actuation(delay=0.0, lag=0.0))
  controller = controllers.make("lq_cm", numbers, model.car, 0.5, task.lock)
  driven = drive(twin, theta[None], controller, model.speed_gains, TrueObserver(), task)
  assert float(np.abs(driven.commands[..., 0]).max()) <= 1.0
  assert float(kpis(driven).rmse[0]) < 0.05


def test_a_voltage_of_the_qcar_is_limited_to_three_nominal_cells():
  assert Model.nominal().speed_gains.limit == 11.1
