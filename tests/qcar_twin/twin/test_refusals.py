"""What is no car, no driving and no twin is refused where it is given; no more than the supply has acts."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.plant import START, Segments
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle


@pytest.fixture(scope="module")
def twin() -> Twin:
  return Twin(Vehicle.load(), threads=1)


@pytest.mark.parametrize("name", ["driveline_friction", "rotor_inertia", "relaxation_length"])
def test_a_number_that_no_calibration_can_scale_is_refused_by_name(name):
  with pytest.raises(ValueError, match=f"{name} is 0, which no calibration can scale; leave it out"):
    Twin(dataclasses.replace(Vehicle.load(), **{name: 0.0}))


@pytest.mark.parametrize("engine", ["mujoco", "reduced"])
def test_no_more_voltage_acts_than_the_supply_has(engine):
  twin = Twin(Vehicle.load(), select(["battery_sag"]), threads=1).on(engine)
  theta = twin.parameters.vector({"battery_sag": 0.1})[None]
  ends = []
  for voltage in (12.0, 24.0, 100.0):
    commands = np.tile([voltage, 0.0], (1, 100, 1))
    segments = Segments(commands, np.zeros((1, len(START))), np.array([100]), 0.01, ("a",), np.zeros(1))
    ends.append(twin.rollout(theta, segments).channel("velocity_x")[0, 0, -1])
  assert ends[0] == ends[1] == ends[2] > 1.0


def test_a_rollout_refuses_what_is_no_driving(twin):
  make = lambda value=1.0, steps=100, period=0.01: Segments(
    np.full((1, 100, 2), value), np.zeros((1, len(START))), np.array([steps]), period, ("a",), np.zeros(1)
  )
  with pytest.raises(ValueError, match="command of segment 0 is no finite number in period 0"):
    make(np.nan)
  with pytest.raises(ValueError, match="steps must be 1 numbers of at most 100"):
    make(steps=300)
  with pytest.raises(ValueError, match=r"control period is 0.01 s, and the segments' 0.02 s"):
    twin.rollout(twin.parameters.nominal, make(period=0.02))
  with pytest.raises(ValueError, match="nothing to drive: 0 parameter vectors"):
    twin.rollout(np.empty((0, len(twin.parameters))), make())


def test_what_is_no_twin_is_said(twin, tmp_path):
  with pytest.raises(TypeError, match="'battery_sag' is no mechanism; mechanisms by name come from select"):
    Twin(Vehicle.load(), ["battery_sag"])
  with pytest.raises(ValueError, match="substeps must be 1 or more, not 0"):
    Twin(Vehicle.load(), substeps=0)
  with pytest.raises(ValueError, match=r"start must be \(N, 7\), as START names it, got \(1, 6\)"):
    twin.begin(twin.parameters.nominal[None], np.zeros((1, 6)))
  with pytest.raises(ValueError, match="mass would be no finite number; nothing was written"):
    save_twin(tmp_path / "twin.toml", twin, twin.parameters.vector({"mass": np.nan}))
  assert not (tmp_path / "twin.toml").exists()
