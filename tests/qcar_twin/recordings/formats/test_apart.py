"""A file that brings its reader down ends in an error of one sentence, and the next file is read as if nothing were."""

import os
import signal
import time

import numpy as np
import pytest
import scipy.io

from qcar_twin.recordings.formats import apart, matlab, read_table
from qcar_twin.recordings.recording import RecordingError
from tests.faults.mutations import damaged
from tests.faults.samples import KINDS

MODULE = "reader_for_a_test"
READER = """
import os, signal, time
from pathlib import Path
import numpy as np

def groups(path, label):
  asked = path.read_text()
  if asked == "loop":
    while True: pass
  if asked == "much":
    np.ones(1 << 34)
  if asked == "wrong":
    raise KeyError("what a library says")
  print("a library's chatter")
  if asked.startswith("SIG"):
    os.kill(os.getpid(), getattr(signal, asked))
  yield np.arange(3.0), {"a": np.arange(3.0) + 1, "nothing": np.empty(0)}
  yield None, {"b \\n": np.arange(4)[::2]}
"""


@pytest.fixture
def ask(tmp_path, monkeypatch):
  """Reads a file of the given text in a process whose reader does what the text says."""
  (tmp_path / f"{MODULE}.py").write_text(READER)
  monkeypatch.setenv("PYTHONPATH", str(tmp_path))
  monkeypatch.setattr(apart, "SECONDS", 1)

  def read(text):
    (tmp_path / "asked").write_text(text)
    return apart.read_apart(MODULE, tmp_path / "asked", "asked")

  yield read
  apart.end_all()


def good(groups):
  (clock, columns), (none, others) = groups
  assert (clock == [0, 1, 2]).all() and (columns["a"] == [1, 2, 3]).all() and columns["nothing"].size == 0
  assert none is None and (others["b \n"] == [0, 2]).all() and clock.flags.writeable


def test_groups_come_back_and_the_process_stays_for_the_next_file(ask):
  good(ask("x"))
  first = apart._processes[MODULE, os.getpid()].pid
  with pytest.raises(ValueError, match="what a library says"):
    ask("wrong")
  with pytest.raises(MemoryError):
    ask("much")
  good(ask("y"))
  assert apart._processes[MODULE, os.getpid()].pid == first


@pytest.mark.parametrize("name", ["SIGSEGV", "SIGKILL"])
def test_a_signal_is_told_and_the_next_file_is_read(ask, name):
  with pytest.raises(apart.ReaderEnded, match=f"brings its reader down, {name}"):
    ask(name)
  good(ask("x"))


def test_a_reader_without_end_is_ended(tmp_path, ask):
  code = (tmp_path / f"{MODULE}.py").read_text()
  sooner = "from qcar_twin.recordings.formats import apart\nimport sys\nsys.modules['__main__'].SECONDS = 1\n"
  (tmp_path / f"{MODULE}.py").write_text(sooner + code)
  began = time.monotonic()
  with pytest.raises(apart.ReaderEnded, match="takes more than 1 s"):
    ask("loop")
  assert time.monotonic() - began < 60


def test_a_process_that_is_gone_is_replaced(ask):
  good(ask("x"))
  gone = apart._processes[MODULE, os.getpid()]
  os.kill(gone.pid, signal.SIGKILL)
  gone.wait()
  good(ask("x"))


def test_a_module_that_cannot_be_imported_is_an_error(tmp_path):
  with pytest.raises(apart.ReaderEnded):
    apart.read_apart("no_such_module_anywhere", tmp_path, "asked")


@pytest.mark.parametrize("seed", [1000242, 1000297])
def test_mat_files_that_crash_the_library_name_themselves_and_the_cure(tmp_path, seed):
  """Of `tests.faults.fuzz`; the second of two reads is of a good file."""
  KINDS["mat"].make(tmp_path)
  whole = (tmp_path / "run.mat").read_bytes()
  (tmp_path / "run.mat").write_bytes(damaged(whole, seed, False))
  with pytest.raises(RecordingError, match=r"run\.mat: is not a readable \.mat file .*; save it again with -v7"):
    read_table(tmp_path / "run.mat")
  (tmp_path / "run.mat").write_bytes(whole)
  assert read_table(tmp_path / "run.mat").rows > 10


def test_the_error_of_a_reader_that_came_down_names_the_file(tmp_path, monkeypatch):
  def dies(module, path, label):
    raise apart.ReaderEnded("it brings its reader down, SIGSEGV")

  scipy.io.savemat(tmp_path / "a.mat", {"time": np.arange(3.0)})
  monkeypatch.setattr(matlab, "read_apart", dies)
  with pytest.raises(RecordingError) as caught:
    read_table(tmp_path / "a.mat")
  said = "a.mat: is not a readable .mat file (it brings its reader down, SIGSEGV); save it again with -v7"
  assert str(caught.value) == said


def test_small_files_cost_little_once_the_process_runs(tmp_path):
  scipy.io.savemat(tmp_path / "a.mat", {"time": np.arange(300.0), "speed": np.arange(300.0)})
  read_table(tmp_path / "a.mat")
  spent = []
  for _ in range(3):
    began = time.monotonic()
    assert read_table(tmp_path / "a.mat").rows == 300
    spent.append(time.monotonic() - began)
  assert min(spent) < 1.0


def test_an_array_with_a_row_for_each_sample_is_its_columns(tmp_path):
  time = np.arange(40) / 50.0
  state, gyro = np.arange(160.0).reshape(40, 4), np.arange(120.0).reshape(40, 3)
  np.savez(tmp_path / "run.npz", time=time, state=state, gyro=gyro, scan=np.zeros((40, 360)))
  read = read_table(tmp_path / "run.npz")
  assert read.number("state[3]", "speed").tolist() == state[:, 3].tolist()
  assert read.number("gyro.z", "yaw_rate").tolist() == gyro[:, 2].tolist() and "scan" not in read
