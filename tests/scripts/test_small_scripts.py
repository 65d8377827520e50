"""Scripts that make a session, open its truth, and time the twin."""

import json
import runpy
from pathlib import Path

import pytest

from qcar_twin.dataset import DataSet

ROOT = Path(__file__).resolve().parents[2]


def script(name):
  return runpy.run_path(str(ROOT / "scripts" / f"{name}.py"))


@pytest.fixture(scope="module")
def session(tmp_path_factory):
  """A quick session with one effect at half its typical size, and where it lies."""
  made, folder = script("make_session"), tmp_path_factory.mktemp("session")
  config = made["Config"](
    folder / "data", seed=5, effect=("steering_offset",), size=(0.5,), packed=True, quick=True, clean=True
  )
  return made["main"](config), folder


def test_make_session_writes_a_data_set_that_loads(session):
  data, folder = session
  assert {r.role for r in data.recordings} == {"identify", "validate", "holdout"}
  assert {"voltage_step", "circle"} <= {r.manoeuvre for r in data.recordings}
  again = DataSet.load(folder / "data")
  assert [r.name for r in again.recordings] == [r.name for r in data.recordings]
  assert (folder / "data_truth" / "clean.npz").is_file()


def test_the_truth_is_told_only_by_the_sealed_file(session, capsys):
  _, folder = session
  told = [p for p in folder.rglob("*") if p.is_file() and b"steering_offset" in p.read_bytes()]
  assert told == []
  opened = script("unseal")
  truth = opened["main"](opened["Config"](folder / "data_truth", folder / "data"))
  assert json.loads(capsys.readouterr().out) == truth
  assert "steering_offset" in json.dumps(truth)


def test_make_session_wants_an_effect_for_every_size(tmp_path):
  made = script("make_session")
  with pytest.raises(SystemExit, match="2 sizes for 1 effects: give each --size after its --effect"):
    made["main"](made["Config"](tmp_path / "data", effect=("payload",), size=(1.0, 2.0)))
  assert not (tmp_path / "data").exists()


def test_make_session_lists_the_effects(tmp_path, capsys):
  made = script("make_session")
  with pytest.raises(SystemExit):
    made["main"](made["Config"](tmp_path / "data", effect=("list",)))
  lines = capsys.readouterr().out.splitlines()
  assert len(lines) > 25 and any(line.startswith("battery_sag ") for line in lines)


def test_benchmark_writes_a_row_for_every_pair(tmp_path, capsys):
  made = script("benchmark")
  pairs = made["main"](made["Config"](tmp_path / "speed.md", quick=True))
  text = (tmp_path / "speed.md").read_text(encoding="utf-8")
  rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| what")]
  assert len(rows) == len(pairs) == 7 and all(f"| {pair.ratio:.2f} |" in text for pair in pairs)
  assert capsys.readouterr().out.count("(goal") == len(pairs)
  assert ("the library itself" in text) is any(pair.sides[0] == "mujoco.sysid" for pair in pairs)
  assert not list(tmp_path.glob(".writing-*"))
