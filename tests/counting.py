"""What stands in for a stopwatch in tests: a clock that ticks when it is read, and the number of calls a piece of work
makes, neither of which depends on the machine."""

import gc
import itertools
import sys
from collections.abc import Callable
from types import SimpleNamespace


def ticking() -> SimpleNamespace:
  """In place of the module `time`: every reading is one second after the last."""
  ticks = itertools.count()
  read = lambda: float(next(ticks))
  return SimpleNamespace(perf_counter=read, process_time=read, monotonic=read)


def calls(work: Callable[[], object]) -> int:
  """Functions that a piece of work calls, those written in C included: a loop over the rows of an array shows."""
  number = 0

  def count(frame, event, argument) -> None:
    nonlocal number
    number += event in ("call", "c_call")

  before, collects = sys.getprofile(), gc.isenabled()
  gc.disable()  # what a collection happens to finalise is not this work's
  sys.setprofile(count)
  try:
    work()
  finally:
    sys.setprofile(before)
    if collects:
      gc.enable()
  return number
