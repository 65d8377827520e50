"""Ends a script that neither looks at a clock nor at the car: time would stand still for it forever."""

import ctypes
import os
import signal
import threading
from _thread import allocate_lock
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from qcar_twin.onboard.clock import Clock

_LOOKS = 0.2  # s on the wall between two looks


class Stuck(BaseException):
  """The script was ended by the watchdog; not an Exception, so that `except Exception` lets it through."""


def sentence(patience: float) -> str:
  """What is said of a script that is stuck."""
  return (
    f"the script ran for {patience:g} s without looking at a clock or at the car, so that simulated time stood still:"
    " a loop without time.sleep(), read() or time.time(), waiting for something outside, or a long computation"
    " (--patience allows more)"
  )


@contextmanager
def watched(clock: Clock, patience: float) -> Iterator[None]:
  """Raise `Stuck` in whichever thread has the turn when nothing has touched the clock for `patience` s."""
  done, main = allocate_lock(), threading.current_thread() is threading.main_thread()
  done.acquire()
  interruptible = main and hasattr(signal, "SIGALRM")

  def bark(_: int, __: FrameType | None) -> None:
    raise Stuck(sentence(patience))

  speaking = type("Stuck", (Stuck,), {"__str__": lambda _: sentence(patience)})  # raised as a class, without arguments
  before = signal.signal(signal.SIGALRM, bark) if interruptible else None
  ident = threading.get_ident()

  def watch() -> None:
    seen, quiet = -1, 0.0
    while not done.acquire(True, _LOOKS):
      quiet = quiet + _LOOKS if clock.touched == seen and not clock.asking else 0.0
      seen = clock.touched
      if quiet >= patience:
        quiet = 0.0
        stuck = clock.thread_of(clock.running) if clock.running else None
        if stuck == ident and interruptible:
          os.kill(os.getpid(), signal.SIGALRM)  # gets through to one that waits for input, too
        elif stuck is not None:
          ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(stuck), ctypes.py_object(speaking))

  watcher = threading.Thread(target=watch, name="watchdog", daemon=True)
  with clock.outside():
    watcher.start()
  try:
    yield
  finally:
    done.release()
    with clock.outside():
      watcher.join()
    if interruptible:
      signal.signal(signal.SIGALRM, before)
