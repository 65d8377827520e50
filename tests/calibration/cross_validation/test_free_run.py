"""A recording driven again: exact on the plant's own data, blind to what was not logged."""

import math

import numpy as np
import pytest

from calibration.cross_validation.cross_validation import cross_validate
from calibration.cross_validation.free_run import CHANNELS, free_run
from calibration.cross_validation.replay import ReferenceBicycle
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.plant import START
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Stream
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests.calibration.identification.bicycle_rig import NUMBERS, PERIOD, THETA, VEHICLE, drive


def lively(**kwargs):
  time = PERIOD * np.arange(500)
  commands = np.stack([1.4 + 0.5 * np.sin(2.0 * time), 0.15 * np.sin(1.3 * time)], axis=-1)
  (recording,) = drive([("oval", "validate", "oval", commands, np.zeros(len(START)))], **kwargs)
  return recording


def test_own_recording_is_met_exactly():
  run = free_run(Bicycle(VEHICLE), THETA, lively(), VEHICLE)
  assert set(run.rmse) == set(CHANNELS)
  for name in ("speed", "yaw_rate", "accel_y"):
    assert run.rmse[name] < 1e-6
  assert run.predicted["speed"].shape == run.time.shape == (501,)
  assert run.commands.shape == (500, 2)


def test_wrong_parameters_show_in_the_channel_they_act_on():
  wrong = THETA * [1.05, 1.0, 1.0, 1.0, 1.0]
  rmse = free_run(Bicycle(VEHICLE), wrong, lively(), VEHICLE).rmse
  assert rmse["speed"] > 0.03
  stiff = THETA * [1.0, 1.0, 1.0, 0.8, 1.0]
  rmse = free_run(Bicycle(VEHICLE), stiff, lively(), VEHICLE).rmse
  assert rmse["speed"] < 1e-6
  assert rmse["yaw_rate"] > 0.003


def test_noise_is_what_is_left():
  rmse = free_run(Bicycle(VEHICLE), THETA, lively(noise=1.0), VEHICLE).rmse
  assert rmse["yaw_rate"] == pytest.approx(0.006 / np.sqrt(11), rel=0.25)  # moving average of eleven samples


def test_only_what_was_logged_is_compared():
  run = free_run(Bicycle(VEHICLE), THETA, lively(channels=("speed", "yaw_rate")), VEHICLE)
  assert set(run.measured) == set(run.rmse) == {"speed", "yaw_rate"}
  assert run.rmse["speed"] < 1e-6


def test_an_oval_is_driven_with_the_fitted_timing_and_seen_by_the_fitted_sensors():
  run, bias, shift = lively(), 0.1, 3
  early = lambda stream: Stream(stream.time, np.append(stream.value[shift:], np.repeat(stream.value[-1], shift)))
  streams = {name: early(run[name]) for name in ("motor_voltage", "steering_command")}
  streams["yaw_rate"] = Stream(run["yaw_rate"].time, run["yaw_rate"].value + bias)
  run = run.replace(streams={**run.streams, **streams})
  twin = Twin(Vehicle.from_dataset(NUMBERS), select(["gyro_bias"]), threads=1)
  theta = twin.parameters.vector({"gyro_bias": bias})
  bicycle = ReferenceBicycle(Bicycle(VEHICLE), THETA, "made")
  found = cross_validate(DataSet("made", (run,), NUMBERS), twin, theta, bicycle, ("validate",), shift, (math.inf,))
  assert found.ovals["oval"]["bicycle"]["yaw_rate"] < 0.01
  assert found.ovals["oval"]["bicycle"]["speed"] < 0.01


def test_rig_has_the_numbers_of_a_vehicle():
  assert VEHICLE.mass == NUMBERS["mass"]
