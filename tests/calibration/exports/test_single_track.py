"""The single track's equations beside the twin, unmatched: wheels that spin, axles on one shaft at full lock."""

import dataclasses

import numpy as np
import pytest

from calibration.exports import gym_track, single_track
from calibration.exports.cars import ModelCars
from calibration.exports.numbers import single_track_numbers
from qcar_twin.plant import Segments, signal_index
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import GRAVITY, Vehicle
from tests import ROOT


def beside_the_twin(volts, steering, layout="all-wheel", **values):
  """Signals of the single track and of the twin, (T, signals) each, driven from rest, and the numbers of the former."""
  twin = car_of(layout)
  theta = twin.parameters.vector(twin.parameters.named(twin.parameters.nominal) | values)
  commands = np.stack([volts, np.full(len(volts), steering)], axis=-1)[None]
  segments = Segments(commands, np.zeros((1, 7)), np.array([len(volts)]), 0.01, ("drive",), np.zeros(1))
  car = single_track_numbers(twin, theta, ())
  other = twin.with_engine(lambda size: ModelCars(single_track, car, size))
  return *(plant.rollout(theta, segments).signals[0, 0] for plant in (other, twin)), car


def car_of(layout):
  data = DataSet.load(ROOT / "data" / "sample")
  return Twin(dataclasses.replace(Vehicle.from_dataset(data.vehicle, data.vehicle_std), layout=layout), threads=1)


def test_the_copy_that_imports_nothing_has_the_twins_gravity():
  assert single_track.GRAVITY == gym_track.GRAVITY == GRAVITY


@pytest.mark.parametrize("layout", ["all-wheel", "rear", "front"])
@pytest.mark.parametrize("grip", [0.8, 0.3])
def test_wheels_that_spin_do_so_in_the_single_track(layout, grip):
  """A launch at 6 V for a second, then none: the rim runs ahead of the car, and the car goes as its tyres give.

  On tyres that hardly relax along: those of the single track do not.
  """
  volts = np.where(np.arange(300) < 100, 6.0, 0.0)
  tyre = {"friction_coefficient": grip, "longitudinal_relaxation": 0.001}
  shown, wanted, car = beside_the_twin(volts, 0.0, layout, **tyre)
  for name, within in (("motor_speed", 0.02), ("velocity_x", 0.04)):
    one, two = (s[:, signal_index(name)] for s in (shown, wanted))
    assert np.sqrt(np.mean((one - two) ** 2)) < within * np.sqrt(np.mean(two**2)), name
  rim = wanted[:, signal_index("motor_speed")] * car["travel_per_radian"]
  assert layout == "all-wheel" or rim[60] > 1.5 * wanted[60, signal_index("velocity_x")]


@pytest.mark.parametrize("stiffness", [150.0, 300.0, 600.0, 1200.0])
def test_two_axles_on_one_shaft_turn_at_full_lock_as_the_twins_do(stiffness):
  """There they slip by a tenth of the speed. `stiffness`: along, of four wheels, N; beyond these one wheel of an axle
  slips for both, which a single track has not."""
  shown, wanted, _ = beside_the_twin(np.full(300, 1.2), 0.5, longitudinal_stiffness=stiffness)
  rate = signal_index("yaw_rate")
  assert shown[-1, rate] == pytest.approx(wanted[-1, rate], rel=0.03)


def test_a_rear_axle_that_spins_lets_go_across():
  """Driven tyres give across what the drive leaves them: at the same voltage the rear drive turns the car in."""
  turned = {}
  for layout in ("rear", "front"):
    twin = car_of(layout)
    car = single_track_numbers(twin, twin.parameters.nominal, ())
    x = single_track.at_start(car, np.array([0, 0, 0, 1.0, 0, 0, 0.1]), np.zeros(2))
    for _ in range(40):
      x, _ = single_track.step(x, np.array([8.0, 0.1]), car)
    turned[layout] = x[5]
  assert turned["rear"] > 1.5 * turned["front"]


@pytest.mark.parametrize(("volts", "steering"), [(1.2, 0.5), (6.0, 0.1)])
def test_an_open_centre_differential_lets_the_axles_turn_as_the_twins_does(volts, steering):
  """It is the limit of a nearly open one, and the twin's own, at full lock and in a launch."""
  open_, twins, car = beside_the_twin(np.full(300, volts), steering, centre_differential=1.0)
  nearly, _, other = beside_the_twin(np.full(300, volts), steering, centre_differential=0.999)
  assert np.isfinite(open_).all() and np.isfinite(car["centre_compliance"])
  assert car["centre_compliance"] > 1e3 * other["centre_compliance"]
  at = signal_index("yaw_rate")
  assert open_[-1, at] == pytest.approx(nearly[-1, at], rel=1e-3)
  assert open_[-1, at] == pytest.approx(twins[-1, at], rel=0.03)
