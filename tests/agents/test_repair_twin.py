"""The script that makes the twins of the study's concealed car, with a diagnosis that takes no time."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from qcar_twin.dataset import DataSet
from qcar_twin.mechanisms import select
from qcar_twin.twin import Twin
from qcar_twin.twin_file import load_twin
from qcar_twin.vehicle import Vehicle

ROOT = Path(__file__).resolve().parents[2]


def test_both_twins_are_left_where_the_study_looks_for_them(tmp_path):
  made = runpy.run_path(str(ROOT / "scripts" / "repair_twin.py"))
  space, asked = made["main"].__globals__, {}

  def diagnosed(dataset, mechanisms, effort, threads):
    asked.update(dataset=dataset, mechanisms=mechanisms)
    twin = Twin(Vehicle.from_dataset(dataset.vehicle, dataset.vehicle_std), select(["steering_delay"]))
    before = twin.parameters.nominal
    before[twin.parameters.index("steering_delay")] = 0.0
    after = np.array(before)
    after[twin.parameters.index("steering_delay")] = 0.08
    return SimpleNamespace(diagnosis=None, twin=twin, before=before, after=after)

  space["diagnose"], space["verdict"] = diagnosed, lambda diagnosis: "the steering is late"
  space["write"] = lambda outcome, folder: None
  config = made["Config"](tmp_path, design="compact", mechanisms=("steering_delay",))
  assert made["main"](config) == "the steering is late"
  assert isinstance(asked["dataset"], DataSet) and asked["mechanisms"] == ("steering_delay",)
  plain, _ = load_twin(tmp_path / "recalibrated.toml")
  repaired, theta = load_twin(tmp_path / "repaired.toml")
  assert not plain.mechanisms and [m.name for m in repaired.mechanisms] == ["steering_delay"]
  assert repaired.parameters.named(theta)["steering_delay"] == 0.08
  assert (tmp_path / "session" / "dataset.toml").is_file() and (tmp_path / "session" / "truth.sha256").is_file()
