"""Axles that are open, locked, or one of the two, as a car's description says."""

import dataclasses

import numpy as np
import pytest

from qcar_twin.plant import SIGNALS
from qcar_twin.twin.file import load_twin, save_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.mechanisms.base import CarDimensions
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR, Vehicle


def test_whether_an_axle_is_locked_is_open_only_where_nobody_says():
  lock = select(["differential_lock"])[0]
  usual = lambda **given: lock.tolerances(CarDimensions.of(Vehicle.from_dataset(given, {})), {})["differential_lock"]
  assert usual() == usual(layout="rear", differential="open") < 0.1  # oil
  assert 3.0 * usual(layout="rear") == pytest.approx(1.0)
  assert usual(layout="front", differential="locked") == 0.0


@pytest.mark.parametrize("engine", ["reduced", "mujoco"])
def test_an_axle_that_is_said_to_be_locked_is_one(engine):
  def turning(differential: str, degree: float) -> float:
    car = dataclasses.replace(QCAR, layout="rear", differential=differential)
    twin = Twin(car, select(["differential_lock"]), threads=1, engine=engine)
    theta = twin.parameters.vector(twin.parameters.named(twin.parameters.nominal) | {"differential_lock": degree})
    cars = twin.begin(theta[None], np.zeros((1, 7)))
    rolling = [cars.step(np.array([[2.0, 0.3]])).copy() for _ in range(250)]
    return float(rolling[-1][0, SIGNALS.index("yaw_rate")])

  assert turning("locked", 0.0) == pytest.approx(turning("open", 1.0), rel=1e-6)
  assert turning("locked", 0.0) < 0.9 * turning("open", 0.0)


def test_a_twin_file_keeps_what_is_said_of_an_axle(tmp_path):
  car = Vehicle.from_dataset({"layout": "rear", "differential": "locked"}, {})
  twin = Twin(car, threads=1)
  back, _ = load_twin(save_twin(tmp_path / "twin.toml", twin, twin.parameters.nominal), threads=1)
  assert back.vehicle == car


def test_a_word_for_an_axle_that_nobody_knows_is_refused_with_the_known_ones():
  with pytest.raises(ValueError, match="differential must be one of open, locked, unknown, not 'spool'"):
    Vehicle.from_dataset({"layout": "rear", "differential": "spool"}, {})
