"""Figures of an identification: all written, in the house's colours, hold-outs closed."""

import dataclasses

import numpy as np
import pytest
from bicycle_rig import PERIOD, VEHICLE, drive, session
from matplotlib.colors import same_color

from calibration import figures
from calibration.free_run import free_run
from calibration.identify import identify
from calibration.longitudinal import motor_steps
from calibration.turns import find_turns
from qcar_twin.plant import START


def oval(role="validate"):
  time = PERIOD * np.arange(300)
  commands = np.stack([1.5 + 0 * time, 0.2 * np.sin(2.0 * time)], axis=-1)
  return drive([(f"oval_{role}", role, "oval", commands, np.zeros(len(START)))])


@pytest.fixture(scope="module")
def dataset():
  steps = session(noise=0.3)
  return dataclasses.replace(steps, recordings=(*steps.recordings, *oval(), *oval("holdout")))


@pytest.fixture(scope="module")
def found(dataset):
  return identify(dataset, transient="linear")


def test_every_figure_is_written_and_nothing_else(found, dataset, tmp_path):
  written = figures.draw(found, dataset, VEHICLE, tmp_path / "figures")
  names = {path.name for path in written}
  assert names == {
    "steady_speed.png", "voltage_steps.png", "steady_lateral.png", "steering_steps.png", "oval_validate.png",
  }  # fmt: skip
  assert {path.name for path in (tmp_path / "figures").iterdir()} == names
  assert all(path.read_bytes()[:4] == b"\x89PNG" for path in written)


def test_without_tyres_only_the_drive_is_drawn(dataset, tmp_path):
  drive_only = dataclasses.replace(dataset, recordings=tuple(r for r in dataset.recordings if "volt" in r.name))
  written = figures.draw(identify(drive_only), drive_only, VEHICLE, tmp_path)
  assert {path.name for path in written} == {"steady_speed.png", "voltage_steps.png"}


def lines(figure):
  return {line.get_label(): line for axes in figure.axes for line in axes.get_lines()}


def test_measured_is_black_and_the_bicycle_orange(found, dataset):
  recordings = [r for r in dataset.recordings if r.role != "holdout"]
  steps, _ = motor_steps(recordings, VEHICLE.gear_ratio * VEHICLE.wheel_radius)
  for figure in (
    figures.voltage_steps(found, steps),
    figures.steering_steps(found, find_turns(recordings, VEHICLE), VEHICLE),
  ):
    drawn = lines(figure)
    assert same_color(drawn["measured"].get_color(), "black")
    assert same_color(drawn["bicycle"].get_color(), "tab:orange")
    assert sum(axes.has_data() for axes in figure.axes) == 4


def test_steady_points_are_those_of_the_table(found):
  drawn = lines(figures.steady_speed(found))
  identified = [s for s in found.drive.steps if s.role == "identify"]
  np.testing.assert_allclose(drawn["identified"].get_ydata(), [s.measured for s in identified])
  drawn = lines(figures.steady_lateral(found, VEHICLE))
  assert len(drawn["validation"].get_ydata()) == 2


def test_models_are_compared_by_name_with_their_error(found):
  plain, theta = found.bicycle(VEHICLE)
  run = free_run(plain, theta, oval()[0], VEHICLE)
  figure = figures.driven_again({"bicycle": run, "twin": run}, {"bicycle": "tab:orange", "twin": "tab:blue"})
  labels = lines(figure)
  assert f"twin: {run.rmse['speed']:.3g} m/s" in labels
  assert same_color(labels[f"twin: {run.rmse['speed']:.3g} m/s"].get_color(), "tab:blue")
