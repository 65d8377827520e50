"""Parts of an array filled by copies of this process: the same whatever the number, and whatever becomes of a copy."""

import multiprocessing
import os
import sys
import time

import numpy as np
import pytest

from calibration import copies
from calibration.copies import filled


def powers(out: np.ndarray, first: int, last: int) -> None:
  out[first:last] = np.arange(first, last)[:, None] ** np.arange(out.shape[1])


@pytest.mark.parametrize("workers", [1, 2, 3, 7, 40])
def test_an_array_is_the_same_whatever_the_number_of_processes(workers):
  np.testing.assert_array_equal(filled(powers, 7, 4, workers), np.arange(7)[:, None] ** np.arange(4))


def test_several_processes_do_work_and_end():
  pids = filled(lambda out, first, last: out[first:last].fill(os.getpid()), 6, 2, 3)
  assert len(np.unique(pids)) == 3
  assert pids[0, 0] == os.getpid()
  assert not multiprocessing.active_children()


@pytest.mark.parametrize("shape", [(0, 3), (3, 0)])
def test_nothing_to_do_is_no_error(shape):
  assert filled(powers, *shape, workers=2).shape == shape


def leaves(_out, _first, _last):
  os._exit(3)


def kills_itself(_out, _first, _last):
  os.kill(os.getpid(), 9)


def fails(_out, _first, _last):
  raise ArithmeticError("in a copy")


def hangs(_out, _first, _last):
  time.sleep(600)


@pytest.mark.parametrize("ends", [leaves, kills_itself, fails, hangs])
def test_what_a_copy_does_not_get_done_is_done_here(ends, monkeypatch, capfd):
  monkeypatch.setattr(copies, "_PATIENCE", 0.5)
  here = os.getpid()

  def fill(*part):
    (powers if os.getpid() == here else ends)(*part)

  out = filled(fill, 7, 4, 2)
  np.testing.assert_array_equal(out, np.arange(7)[:, None] ** np.arange(4))
  assert not multiprocessing.active_children()
  assert capfd.readouterr() == ("", "")


def test_an_error_here_ends_the_copies():
  here = os.getpid()

  def fill(*part):
    if os.getpid() == here:
      raise KeyboardInterrupt
    hangs(*part)

  with pytest.raises(KeyboardInterrupt):
    filled(fill, 4, 4, 2)
  assert not multiprocessing.active_children()


def test_where_processes_cannot_be_copied_safely_one_works(monkeypatch):
  monkeypatch.setattr(sys, "platform", "linux")
  assert copies.copies() == os.cpu_count()
  monkeypatch.setattr(sys, "platform", "darwin")
  assert copies.copies() == 1
