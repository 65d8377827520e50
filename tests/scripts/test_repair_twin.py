"""The command that makes the twins of the study's concealed car, with a diagnosis that takes no time."""

from types import SimpleNamespace

import numpy as np

from calibration.concealed.laboratory.designs import DESIGNS
from calibration.fitting.windows import Cut
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from scripts import repair_twin
from tests.scripts.short_design import short


def test_both_twins_are_left_where_the_study_looks_for_them(tmp_path, monkeypatch):
  asked = {}

  def diagnosed(dataset, candidates, effort, threads, progress):
    asked.update(dataset=dataset, candidates=candidates)
    twin = Twin(Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std), select(["steering_delay"]))
    before = twin.parameters.nominal
    before[twin.parameters.index("steering_delay")] = 0.0
    after = np.array(before)
    after[twin.parameters.index("steering_delay")] = 0.08
    return SimpleNamespace(diagnosis=None, twin=twin, before=before, after=after, cut=Cut())

  monkeypatch.setitem(DESIGNS, "compact", short)
  monkeypatch.setattr(repair_twin, "diagnose", diagnosed)
  monkeypatch.setattr(repair_twin, "verdict", lambda diagnosis: "the steering is late")
  monkeypatch.setattr(repair_twin, "write_diagnosis", lambda outcome, folder: None)
  config = repair_twin.Config(tmp_path, design="compact", candidates=("steering_delay",))
  assert repair_twin.main(config) == "the steering is late"
  assert isinstance(asked["dataset"], DataSet) and asked["candidates"] == ("steering_delay",)
  plain, _ = load_twin(tmp_path / "recalibrated.toml")
  repaired, theta = load_twin(tmp_path / "repaired.toml")
  assert not plain.mechanisms and [m.name for m in repaired.mechanisms] == ["steering_delay"]
  assert repaired.parameters.named(theta)["steering_delay"] == 0.08
  assert (tmp_path / "session" / "dataset.toml").is_file() and (tmp_path / "session" / "truth.sha256").is_file()
