"""The comparison of the two cars: shares of noise, cosines, and a page that holds them."""

import numpy as np
import pytest

from calibration.concealed.benchmarks.fast_plant import compare_plants
from qcar_twin.recordings.dataset import DataSet
from scripts import benchmark_plant
from scripts.benchmark_plant import Config, page
from tests import ROOT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def agreement():
  return compare_plants(DataSet.load(ROOT / "data" / "sample"), vectors=3, most=25.0)


def test_the_two_cars_agree_on_the_sample(agreement):
  assert {"accel_x", "yaw_rate", "motor_speed"} <= set(agreement.channels)
  assert agreement.vectors == 3 and all(len(v) == 3 for v in agreement.drawn.values())
  assert 10.0 < agreement.seconds <= 30.0
  assert 0.0 < max(agreement.channels.values()) < 1.0
  assert all(share >= agreement.channels[name] for name, (_, share) in agreement.worst.items())
  for cosines, least in ((agreement.slopes, 5), (agreement.effects, 15)):
    whole, rest = np.array(list(cosines.values())).T
    assert len(cosines) > least and np.median(rest) > 0.98 and np.median(rest) >= np.median(whole)
  assert min(agreement.speed.seconds) > 0.0


def test_the_page_says_how_it_was_made_and_holds_every_row(agreement):
  text = page(agreement, Config(vectors=3, most=25.0))
  assert "`qcar-twin benchmark-plant --dataset data/sample --vectors 3 --seed 0 --most 25`" in text
  assert all(f"| {name} |" in text for name in (*agreement.channels, *agreement.slopes, *agreement.effects))


def test_the_command_writes_the_page(agreement, tmp_path, monkeypatch, capsys):
  monkeypatch.setattr(benchmark_plant, "compare_plants", lambda *given: agreement)
  config = Config(ROOT / "data" / "sample", tmp_path / "page.md", vectors=3, most=25.0)
  benchmark_plant.main(config)
  assert (tmp_path / "page.md").read_text(encoding="utf-8") == page(agreement, config)
  assert f"page: {tmp_path / 'page.md'}" in capsys.readouterr().out
