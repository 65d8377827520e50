"""`qcar-twin benchmark-onboard`: a row a script and car, and what it calls the same."""

import dataclasses

import pytest

from qcar_twin.recordings.recording import Stream
from scripts import benchmark_onboard
from scripts.benchmark_onboard import Config, driven, plants, same
from tests.qcar_twin.onboard.rig import SCRIPTS


def test_a_drive_is_the_same_as_itself_and_as_no_other():
  make = plants(Config(quick=True))["reduced car"]
  one, length, wall, spent = driven(SCRIPTS / "steps.py", make(), 1.5)
  assert length == pytest.approx(1.5, abs=0.02) and wall > 0.0 and spent > 0.0
  assert same(one, one)
  speed = one["motor_speed"]
  off = dataclasses.replace(one, streams={**one.streams, "motor_speed": Stream(speed.time, speed.value + 1e-12)})
  assert not same(one, off)
  assert not same(one, one.window(0.0, 1.0))


def test_the_page_has_a_row_for_every_script(tmp_path):
  (tmp_path / "still.py").write_text("import time\nfrom pal.products.qcar import QCar\nQCar()\ntime.sleep(1)\n")
  text = benchmark_onboard.main(Config(tmp_path / "page.md", tmp_path, quick=True))
  assert "| reduced car | still | 1 |" in text and text.count("| yes |") == 1
  (tmp_path / "still.py").write_text("raise OSError('gone')\n")
  with pytest.raises(RuntimeError, match="OSError: gone"):
    benchmark_onboard.main(Config(tmp_path / "page.md", tmp_path, quick=True))
  with pytest.raises(FileNotFoundError, match="name a folder of .py files with --scripts"):
    benchmark_onboard.main(Config(tmp_path / "page.md", tmp_path / "none", quick=True))
