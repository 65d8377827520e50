"""A run that is killed leaves whole files or none, and a rerun ends as if nothing had been; in small."""

import os
import subprocess
import sys

import numpy as np
import pytest

from qcar_twin.atomic_io import staging, whole_file, whole_folder, write_text
from tests.faults.kills import VICTIMS, broken, differences, finish, torment
from tests.scripts.tiny_session import write

WRITER = """
import os, signal, sys
from pathlib import Path
from qcar_twin.atomic_io import whole_file, whole_folder
with whole_file(Path(sys.argv[1]) / "page.json") as part:
  part.write_text("half of")
  os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
def test_calibration_survives_three_kills(tmp_path):
  write(tmp_path / "data")
  tally, said = torment("calibrate", 3, 3, 2, tmp_path, tmp_path / "data")
  assert not said and tally.kills >= 2 and tally.reruns == 1


@pytest.mark.slow
def test_a_training_killed_before_its_first_checkpoint_begins_anew(tmp_path):
  write_text(tmp_path / "out" / "training.json", "")
  with pytest.raises(RuntimeError, match="training.json"):
    finish("train --out {out} --resume", out=tmp_path / "out")
  (tmp_path / "out" / "training.json").unlink()
  finish(f"{VICTIMS['train'].words} --episodes 8", out=tmp_path / "out")
  for left in ("checkpoint.json", "result.json"):
    (tmp_path / "out" / left).unlink()
  finish(VICTIMS["train"].again, out=tmp_path / "out")
  assert (tmp_path / "out" / "result.json").is_file() and not broken(tmp_path / "out")


def test_what_a_killed_writer_began_is_no_result_and_goes_with_the_next(tmp_path):
  killed = subprocess.run([sys.executable, "-c", WRITER, str(tmp_path)], check=False)
  assert killed.returncode == -9
  assert [path.name[:9] for path in tmp_path.iterdir()] == [".writing-"] and not broken(tmp_path)
  write_text(tmp_path / "page.json", "{}")
  assert [path.name for path in tmp_path.iterdir()] == ["page.json"]


def test_what_a_living_process_writes_is_left_alone(tmp_path):
  with staging(tmp_path) as mine:
    code = f"from qcar_twin.atomic_io import write_text; write_text({str(tmp_path / 'other.json')!r}, '1')"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert mine.is_dir() and str(os.getpid()) in mine.name
  assert [path.name for path in tmp_path.iterdir()] == ["other.json"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_folder_is_replaced_as_a_whole_or_not_at_all(tmp_path, error):
  for content in ("old", "new"):
    with whole_folder(tmp_path / "kept") as part:
      (part / f"{content}.txt").write_text(content)
  assert [path.name for path in (tmp_path / "kept").iterdir()] == ["new.txt"]
  with pytest.raises(error), whole_folder(tmp_path / "kept") as part:
    (part / "half.txt").write_text("ha")
    raise error
  assert [path.name for path in tmp_path.iterdir()] == ["kept"]
  assert [path.name for path in (tmp_path / "kept").iterdir()] == ["new.txt"]


def test_what_is_broken_or_different_is_seen(tmp_path):
  for name in ("whole", "resumed"):
    write_text(tmp_path / name / "calibration.json", '{"seconds": 1, "a": [1]}')
    write_text(tmp_path / name / "twin.toml", "a = 1\n")
  victim = VICTIMS["calibrate"]
  assert not differences(victim, tmp_path / "whole", tmp_path / "resumed")
  write_text(tmp_path / "resumed" / "calibration.json", '{"seconds": 2, "a": [2]}')
  assert differences(victim, tmp_path / "whole", tmp_path / "resumed") == ["calibration.json"]
  with whole_file(tmp_path / "resumed" / "a.npz") as part:
    np.savez(part, a=np.zeros(100))
  data = (tmp_path / "resumed" / "a.npz").read_bytes()
  for name, content in (
    ("a.npz", data[:-50]),
    ("b.json", b"{"),
    ("c.csv", b"a,b\n1,2"),
    ("d.html", b"<html>"),
    ("e", b""),
  ):
    (tmp_path / "resumed" / name).write_bytes(content)
  assert {line.partition(":")[0] for line in broken(tmp_path / "resumed")} == {
    "a.npz",
    "b.json",
    "c.csv",
    "d.html",
    "e",
  }
