"""The comparison of the two cars: shares of noise, cosines, and a page that holds them."""

import numpy as np
import pytest

from calibration.concealed.benchmarks.fast_plant import compare_plants
from qcar_twin.recordings.dataset import DataSet
from scripts import benchmark_plant
from scripts.benchmark_plant import Config, page
from tests import ROOT


@pytest.fixture(scope="module")
def found():
  return compare_plants(DataSet.load(ROOT / "data" / "sample"), vectors=3, most=25.0)


def test_the_two_cars_agree_on_the_sample(found):
  assert {"accel_x", "yaw_rate", "motor_speed"} <= set(found.channels)
  assert found.vectors == 3 and all(len(v) == 3 for v in found.drawn.values())
  assert 10.0 < found.seconds <= 30.0
  assert 0.0 < max(found.channels.values()) < 1.0
  assert all(share >= found.channels[name] for name, (_, share) in found.worst.items())
  for cosines, least in ((found.slopes, 5), (found.effects, 15)):
    whole, rest = np.array(list(cosines.values())).T
    assert len(cosines) > least and np.median(rest) > 0.98 and np.median(rest) >= np.median(whole)
  assert min(found.speed.seconds) > 0.0


def test_the_page_says_how_it_was_made_and_holds_every_row(found):
  text = page(found, Config(vectors=3, most=25.0))
  assert "`qcar-twin benchmark-plant --dataset data/sample --vectors 3 --seed 0 --most 25`" in text
  assert all(f"| {name} |" in text for name in (*found.channels, *found.slopes, *found.effects))


def test_the_command_writes_the_page(found, tmp_path, monkeypatch, capsys):
  monkeypatch.setattr(benchmark_plant, "compare_plants", lambda *given: found)
  config = Config(ROOT / "data" / "sample", tmp_path / "page.md", vectors=3, most=25.0)
  benchmark_plant.main(config)
  assert (tmp_path / "page.md").read_text(encoding="utf-8") == page(found, config)
  assert f"page: {tmp_path / 'page.md'}" in capsys.readouterr().out
