"""docs/guide/tour.ipynb runs from its first cell to its last as it stands, and what is stored is what it says."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import nbformat
import pytest

from qcar_twin.recordings.dataset import DataSet
from tests import ROOT

TOUR = ROOT / "docs" / "guide" / "tour.ipynb"
RUN = """
import sys, nbformat
from nbclient import NotebookClient
book = nbformat.read(sys.argv[1], 4)
NotebookClient(book, timeout=1200, kernel_name="python3", record_timing=False).execute()
nbformat.write(book, "executed.ipynb")
"""


def outputs(book):
  """What the code cells printed, one text after the other."""
  cells = [cell for cell in book.cells if cell.cell_type == "code"]
  return [str(out.get("text", "")) for cell in cells for out in cell.outputs]


def codes(book):
  return [cell for cell in book.cells if cell.cell_type == "code"]


def test_the_tour_is_stored_with_small_outputs_and_without_an_error():
  book = nbformat.read(TOUR, 4)
  nbformat.validate(book)
  assert TOUR.stat().st_size < 1_000_000
  assert all(cell.execution_count == number for number, cell in enumerate(codes(book), 1)), "stored as it was executed"
  assert not [out for cell in codes(book) for out in cell.outputs if out.output_type == "error"]
  said = "\n".join(outputs(book))
  assert "guesses to look at" in said and "Fit to be used" in said and "film.mp4:" in said and "steering_offset" in said
  for path in ("/work", "/tmp", "/root", "/home"):
    assert path not in TOUR.read_text(encoding="utf-8"), path


@pytest.mark.slow
def test_the_tour_runs_and_names_what_was_hidden(tmp_path):
  tools = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
  # a process of its own: the kernel's machinery warns of things that are none of this project's
  done = subprocess.run(
    [sys.executable, "-c", RUN, str(TOUR)],
    cwd=tmp_path,
    env=os.environ | tools,
    capture_output=True,
    text=True,
    check=False,
  )
  assert done.returncode == 0, done.stderr[-3000:]
  diagnosis = json.loads((tmp_path / "diagnosed" / "diagnosis.json").read_text(encoding="utf-8"))
  assert "steering_offset" in [claim["mechanism"] for claim in diagnosis["claims"]]
  mine, made = DataSet.load(tmp_path / "mine"), DataSet.load(tmp_path / "made")
  assert mine.vehicle["mass"] == made.vehicle["mass"] and len(mine.recordings) == len(made.recordings)
  for one, other in zip(mine.recordings, made.recordings, strict=True):
    assert set(other.channels) - {"pose_score"} == set(one.channels)
    for channel in one.channels:
      assert one[channel].value == pytest.approx(other[channel].value, rel=1e-6, abs=1e-6)
  assert all(mine.role(role) for role in ("identify", "validate", "holdout"))
  guessed = tomllib.loads((tmp_path / "mine" / "dataset.toml").read_text(encoding="utf-8"))["channels"]
  assert guessed["yaw_rate"]["scale"] == pytest.approx(0.01745329252)
  assert list((tmp_path / "mcap").glob("*.mcap"))
  executed = nbformat.read(tmp_path / "executed.ipynb", 4)
  said = "\n".join(outputs(executed))
  assert (tmp_path / "film.mp4").is_file() or "no OpenGL" in said
