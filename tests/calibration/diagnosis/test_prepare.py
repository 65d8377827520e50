"""What a diagnosis searches with: the reduced car, unless recalibration has shown that it leads a fit astray."""

import dataclasses
from types import SimpleNamespace

import pytest

from calibration.diagnosis import pipeline
from calibration.fitting.surrogate import Surrogate
from qcar_twin.recordings.dataset import DataSet
from tests import ROOT


@dataclasses.dataclass
class Recalibrated:
  """As far as `prepare` looks at one."""

  problem: SimpleNamespace


@pytest.fixture
def dataset():
  return DataSet.load(ROOT / "data" / "sample")


def prepared(dataset, monkeypatch, guarded=(), plant="reduced"):
  """What `prepare` makes where recalibration ends with these recordings left to MuJoCo."""

  def recalibrate(dataset, twin, start, progress):
    return Recalibrated(SimpleNamespace(twin=twin.guarding(guarded) if isinstance(twin, Surrogate) else twin))

  monkeypatch.setattr(pipeline, "recalibrate_dataset", recalibrate)
  monkeypatch.setattr(pipeline, "on_mujoco", lambda found: Recalibrated(SimpleNamespace(twin=found.problem.twin.exact)))
  return pipeline.prepare(dataset, plant=plant)


def test_the_reduced_car_searches_and_there_is_nothing_to_say(dataset, monkeypatch):
  found = prepared(dataset, monkeypatch)
  assert isinstance(found.recalibrated.problem.twin, Surrogate)
  assert not any("MuJoCo" in note for note in found.notes)


def test_where_it_misled_recalibration_mujoco_searches_and_the_report_names_the_recordings(dataset, monkeypatch):
  found = prepared(dataset, monkeypatch, ["oval", "drive_brake"])
  assert not isinstance(found.recalibrated.problem.twin, Surrogate)
  assert found.notes[-1].endswith("the reduced car leads a fit astray in drive_brake, oval")


def test_mujoco_alone_where_it_was_asked_for(dataset, monkeypatch):
  found = prepared(dataset, monkeypatch, ["oval"], "mujoco")
  assert not isinstance(found.recalibrated.problem.twin, Surrogate)
  assert found.recalibrated.problem.twin.engine == "mujoco"
