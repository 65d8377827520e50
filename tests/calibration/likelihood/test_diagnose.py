"""A diagnosis by likelihood from end to end, on a short drive of the twin itself."""

import dataclasses
import json

import numpy as np
import pytest

from calibration.campaign.cases import Case
from calibration.campaign.run import run_case
from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.likelihood.diagnose import diagnose_by_likelihood, document, harmless, material
from calibration.likelihood.levels import levels
from qcar_twin.atomic_io import plain
from qcar_twin.plant import START, Segments, signal_index
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.recording import Recording
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

CAR = Vehicle.load()
PERIODS, OFFSET = 300, 0.04


def dataset(offset: float) -> DataSet:
  rng, time = np.random.default_rng(3), 0.01 * np.arange(PERIODS)
  twin = Twin(CAR, select(["steering_offset"]), engine="reduced", threads=1)
  theta, made = twin.parameters.vector({"steering_offset": offset}), []
  for k, role in enumerate(("identify", "identify", "validate", "holdout")):
    drive = 0.9 + 0.3 * np.sin((1.5 + 0.3 * k) * time)
    commands = np.stack([drive, 0.12 * np.sin((3.0 + 0.5 * k) * time)], axis=-1)
    segments = Segments(commands[None], np.zeros((1, len(START))), np.full(1, PERIODS), 0.01, ("a",), np.zeros(1))
    signals = twin.simulate(theta[None], segments)[0, 0, :PERIODS]
    table = {"motor_voltage": commands[:, 0], "steering_command": commands[:, 1]}
    for name, std in (("motor_speed", 0.5), ("accel_x", 0.05), ("accel_y", 0.05), ("yaw_rate", 0.006)):
      table[name] = signals[:, signal_index(name)] + std * rng.normal(size=PERIODS)
    for name in ("pose_x", "pose_y", "pose_yaw"):
      value = signals[:, signal_index(name)] + 0.003 * rng.normal(size=PERIODS)
      table[name] = np.where(np.arange(PERIODS) % 10 == 0, value, np.nan)
    made.append(Recording.from_columns(f"run_{k}", time, table, file=f"run_{k}.csv", role=role))
  stated = {name: getattr(CAR, name) for name in ("mass", "cg_to_front", "cg_to_rear", "wheel_radius", "gear_ratio")}
  return DataSet("offset", tuple(made), stated, {})


@pytest.mark.parametrize(("offset", "names"), [(OFFSET, ["steering_offset"]), (0.0, [])])
def test_an_offset_is_named_where_it_is_and_not_where_it_is_not(offset, names):
  found = diagnose_by_likelihood(dataset(offset), ["steering_offset", "battery_sag"], substeps=2, threads=1)
  told = document(found)
  assert [c["mechanism"] for c in told["claims"]] == names
  json.dumps(plain(told))
  if names:
    size = told["claims"][0]["parameters"]["steering_offset"]
    assert abs(size["value"] - OFFSET) < 0.15 * OFFSET
    assert found.holdout["yaw_rate"].after < found.holdout["yaw_rate"].before


def channel(before: float, after: float) -> ChannelFit:
  return ChannelFit(before, after, 0.5, 0.5, (0.0, 0.0), "-", 100)


def test_a_name_that_moves_no_free_run_is_not_material():
  limits = levels()
  assert material({"a": channel(1.0, 0.9), "b": channel(1.0, 1.0)}, limits)
  assert not material({"a": channel(1.0, 0.999)}, limits)
  assert material({}, limits)


def test_a_twin_that_gets_surely_worse_is_not_shipped():
  limits = levels()
  sure, chance = (dataclasses.replace(channel(1.0, 1.1), ci95=ci) for ci in ((0.02, 0.2), (-0.05, 0.2)))
  assert not harmless({"a": channel(1.0, 0.5), "b": sure}, limits)
  assert harmless({"b": chance, "c": channel(1.0, 1.005)}, limits)


def test_an_engine_that_there_is_not_is_refused(tmp_path):
  with pytest.raises(ValueError, match="likelihood"):
    run_case(Case("null_00", "null", 1, (), 1.0), tmp_path, engine="oracle")
