"""What a diagnosis searches with: the reduced car, unless recalibration has shown that it leads a fit astray."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis import pipeline
from calibration.fitting.surrogate import Surrogate
from qcar_twin.recordings.dataset import DataSet
from tests import ROOT


@dataclasses.dataclass
class Recalibrated:
  """As far as `prepare` looks at one."""

  problem: SimpleNamespace
  fit: SimpleNamespace


@pytest.fixture
def dataset():
  return DataSet.load(ROOT / "data" / "sample")


def prepared(dataset, monkeypatch, guarded=(), plant="reduced"):
  """What `prepare` makes where recalibration ends with these stretches left to MuJoCo."""

  def recalibrate(dataset, twin, start, progress, ages):
    base = twin.base
    fit = SimpleNamespace(parameters=base, theta=base.nominal, at_bound=np.zeros(len(base), dtype=bool))
    return Recalibrated(SimpleNamespace(twin=twin.guarding(guarded) if isinstance(twin, Surrogate) else twin), fit)

  monkeypatch.setattr(pipeline, "recalibrate_dataset", recalibrate)
  return pipeline.prepare(dataset, plant=plant)


def test_the_reduced_car_searches_and_there_is_nothing_to_say(dataset, monkeypatch):
  found = prepared(dataset, monkeypatch)
  assert isinstance(found.recalibrated.problem.twin, Surrogate)
  assert not any("MuJoCo" in note for note in found.notes)


def test_where_it_misled_recalibration_the_report_names_the_stretches(dataset, monkeypatch):
  found = prepared(dataset, monkeypatch, [("oval", 12.0), ("drive_brake", 0.0)])
  assert found.recalibrated.problem.twin.guarded == {("oval", 12.0), ("drive_brake", 0.0)}
  assert "drive_brake from 0 s, oval from 12 s; there the reduced car leads a fit astray" in found.notes[-1]


def test_mujoco_alone_where_it_was_asked_for(dataset, monkeypatch):
  found = prepared(dataset, monkeypatch, [("oval", 0.0)], "mujoco")
  assert not isinstance(found.recalibrated.problem.twin, Surrogate)
  assert found.recalibrated.problem.twin.engine == "mujoco"
