"""MuJoCo's profiling clock: its Python package starts one, which costs a car about a tenth of every step."""

import contextlib
import ctypes
import logging
from collections.abc import Iterator
from pathlib import Path

import mujoco

log = logging.getLogger(__name__)


def stop_timers() -> bool:
  """Stop the clock behind MjData.timer, in this process. Results of a simulation don't depend on it.

  `mujoco.set_mjcb_time(None)` doesn't: it puts the package's own clock back, and so starts it again.

  Returns:
    Whether it was stopped; False where the engine's library can't be found, which costs speed only.
  """
  clock = _clock()
  if clock is None:
    log.debug("profiling clock goes on: the engine's library was not found")
    return False
  clock.value = None
  return True


@contextlib.contextmanager
def timers_stopped() -> Iterator[None]:
  """The clock stopped for a while, then as it was."""
  clock = _clock()
  before = clock.value if clock else None
  stop_timers()
  try:
    yield
  finally:
    if clock:
      clock.value = before


def _clock() -> ctypes.c_void_p | None:
  """The engine's pointer to its clock."""
  folder = Path(str(mujoco.__file__)).parent
  for library in (*sorted(folder.glob("libmujoco*.so*")), *sorted(folder.glob("libmujoco*.dylib"))):
    with contextlib.suppress(OSError, ValueError):
      return ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time")
  return None
