"""A large array whose parts are filled at the same time, each by a copy of this process.

Mechanisms are steps of NumPy on short arrays, which threads of one interpreter do one after the other. A copy has
everything at hand that the process had, so nothing is sent but the result, through memory that both share.
"""

import contextlib
import gc
import logging
import mmap
import multiprocessing
import multiprocessing.process
import os
import signal
import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Fill = Callable[[Array, int, int], None]

log = logging.getLogger(__name__)

_PATIENCE = 5.0  # times as long as this process took for its own part, and as many s, until a copy counts as lost


def copies() -> int:
  """How many processes can work at once that way: one per core, or one where processes can't be copied safely.

  Elsewhere than on Linux system libraries may have threads of their own, which a copy lacks.
  """
  alone = sys.platform != "linux" or multiprocessing.current_process().daemon
  return 1 if alone else os.cpu_count() or 1


def filled(fill: Fill, rows: int, columns: int, workers: int) -> Array:
  """An array (rows, columns).

  Args:
    fill: writes rows from one to another, the latter not included, of the array that it is given. It runs in copies
      of this process: what else it changes is lost, and threads that were there before are not.
    rows, columns: of the array.
    workers: processes, this one included, each with a part of about equal size. What a copy could not do, or did not
      get done, is done here.
  """
  workers = min(workers, rows)
  if workers < 2 or columns == 0:
    out = np.empty((rows, columns))
    fill(out, 0, rows)
    return out
  out = np.frombuffer(mmap.mmap(-1, 8 * rows * columns), dtype=np.float64).reshape(rows, columns)
  ends = [round(rows * k / workers) for k in range(workers + 1)]
  parts = list(zip(ends[1:-1], ends[2:], strict=True))
  context = multiprocessing.get_context("fork")
  children = [context.Process(target=_fill, args=(fill, out, *part), daemon=True) for part in parts]
  with contextlib.ExitStack() as at_the_end:
    for child in children:
      child.start()
      at_the_end.callback(_ended, child)
    begun = time.monotonic()
    fill(out, 0, ends[1])
    patience = _PATIENCE * (1.0 + time.monotonic() - begun)
    for child, part in zip(children, parts, strict=True):
      child.join(max(0.0, begun + patience - time.monotonic()))
      if child.exitcode != 0:
        log.debug("a copy of the process that simulated came to nothing (%s): done again", child.exitcode)
        _ended(child)
        fill(out, *part)
  return out


def _fill(fill: Fill, out: Array, first: int, last: int) -> None:
  """What a copy does: nobody but the first process answers to the keyboard and the log."""
  gc.freeze()  # what was made before is never collected here: a batch would wait for its threads, which are not here
  signal.signal(signal.SIGINT, signal.SIG_IGN)
  logging.disable(logging.CRITICAL)
  ended = 1  # what is not done is done again by the first process, which then says what is wrong
  try:
    fill(out, first, last)
    ended = 0
  finally:
    os._exit(ended)  # at once: a lock of a thread that is not here, as that of a stream, is never released


def _ended(child: multiprocessing.process.BaseProcess) -> None:
  if child.is_alive():
    child.kill()
  child.join()
