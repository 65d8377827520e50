"""A script run on a simulated car from its first line to its end, however it ends."""

import dataclasses
import os
import random
import runpy
import signal
import sys
import threading
import time
import traceback
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest import mock

import numpy as np

from qcar_twin.onboard.answers import answered
from qcar_twin.onboard.car import Car
from qcar_twin.onboard.clock import Clock, Deadlock, DriveOver
from qcar_twin.onboard.offer import OfferedModules, in_place, offered
from qcar_twin.onboard.plants import OnboardPlant
from qcar_twin.onboard.rig import Rig
from qcar_twin.onboard.standing_in import simulated_time
from qcar_twin.onboard.watchdog import Stuck, watched


@dataclasses.dataclass(frozen=True)
class Terms:
  """How a script is driven.

  Attributes:
    arguments: of its command line.
    name: of the recording, of which the noise goes by; the script's where not given.
    seconds: of simulated time after which it is stopped as by Ctrl-C.
    patience: seconds on the wall for which it may compute without looking at a clock or at the car.
    seed: of the sensors' noise, and of Python's and NumPy's shared random numbers.
    real_time: whether a simulated second takes a second.
    answer: to what it asks by `input`, in turn.
    library: folder with the owner's own library of the car, for what is not offered here.
  """

  arguments: tuple[str, ...] = ()
  name: str = ""
  seconds: float = 600.0
  patience: float = 30.0
  seed: int = 0
  real_time: bool = False
  answer: tuple[str, ...] = ()
  library: Path | None = None

  def __post_init__(self) -> None:
    if not self.seconds > 0.0 or not self.patience > 0.0:
      raise ValueError(f"seconds and patience must be positive, not {self.seconds:g} and {self.patience:g}")


@dataclasses.dataclass(frozen=True)
class Drive:
  """What came of it.

  Attributes:
    car: with all that was logged.
    seconds: driven, simulated.  wall: that it took, s.
    error: what ended the script before its end, with its own traceback; "" where nothing did.
    notes: what its driver should know, in sentences.
  """

  car: Car
  seconds: float
  wall: float
  error: str
  notes: tuple[str, ...]


def drive(script: Path, plant: OnboardPlant, terms: Terms = Terms()) -> Drive:
  """Run a script on a car.

  Raises:
    FileNotFoundError: no such script.
  """
  script = Path(script)
  if not script.is_file():
    raise FileNotFoundError(f"{script}: no such script; name the Python file that drives the QCar")
  # no two recordings' noise is the same
  noise = zlib.crc32(f"{terms.seed} {plant.sensors} {terms.name or script.stem}".encode())
  car, began = Car(plant, noise), time.perf_counter()
  clock = Clock(car.move, terms.seconds, terms.real_time)
  rig = Rig(car, clock)
  with ExitStack() as stack:
    stack.enter_context(_own_surroundings(script, terms))
    stack.enter_context(in_place(OfferedModules(offered(rig), terms.library)))
    stack.enter_context(simulated_time(clock))
    unheard = stack.enter_context(answered(clock, terms.answer))
    stack.enter_context(watched(clock, terms.patience))
    error = _run(script, clock)
  notes = [*([] if error else rig.notes()), *(_lost(name, fault, script) for name, fault in clock.lost)]
  if unheard:
    notes.append(f"the script asked '{unheard[0]}' and heard Enter, since nobody is there; --answer gives another one")
  if clock.stopped:
    notes.append(f"the script was stopped after {terms.seconds:g} s of driving, as by Ctrl-C; --seconds says when")
  return Drive(car, clock.now, time.perf_counter() - began, error, tuple(notes))


def _run(script: Path, clock: Clock) -> str:
  """The script and its threads on the clock; what ended it, "" where it came to its end."""
  with clock.main():
    try:
      error = _said(script, clock, _execute)
      return error or _said(script, clock, lambda *_: clock.finish())
    finally:
      clock.end()


def _execute(script: Path, clock: Clock) -> None:
  runpy.run_path(str(script), run_name="__main__")


def _said(script: Path, clock: Clock, part: Callable[[Path, Clock], None]) -> str:
  """Do a part of the run; what went wrong, in words."""
  try:
    part(script, clock)
  except DriveOver:
    return f"{clock.failure}" if clock.failure is not None else ""
  except KeyboardInterrupt:
    return "" if clock.stopped else "stopped by Ctrl-C"
  except SystemExit as end:
    return "" if end.code in (None, 0) else f"the script ended itself with exit code {end.code}"
  except Stuck as stuck:
    return str(stuck)
  except Deadlock as deadlock:
    return f"{deadlock}; see which lock, event or thread it waits for"
  except Exception as error:
    return own_traceback(error, script)
  return ""


def _lost(name: str, error: BaseException, script: Path) -> str:
  said = str(error) if isinstance(error, Stuck) else own_traceback(error, script)
  return f"thread '{name}' ended early, the script went on without it: {said}"


def own_traceback(error: BaseException, script: Path) -> str:
  """The traceback of an error as if the script had been started by itself."""
  story = traceback.TracebackException.from_exception(error)
  names = [str(script), str(script.resolve())]
  first = next((k for k, frame in enumerate(story.stack) if frame.filename in names), len(story.stack))
  here = str(Path(__file__).parent)
  kept = [frame for frame in story.stack[first:] if not frame.filename.startswith(here)]
  story.stack = traceback.StackSummary.from_list(kept)
  return "".join(story.format(chain=False)).rstrip()


@contextmanager
def _own_surroundings(script: Path, terms: Terms) -> Iterator[None]:
  """Command line, import path, random numbers and answers to signals, as a script of its own would have them."""
  folder, modules = str(script.resolve().parent), set(sys.modules)
  python, shared = random.getstate(), np.random.get_state()
  random.seed(terms.seed)
  np.random.seed(terms.seed)
  with ExitStack() as stack:
    stack.enter_context(mock.patch.object(sys, "argv", [str(script), *terms.arguments]))
    stack.enter_context(mock.patch.object(sys, "path", [folder, *sys.path]))
    stack.enter_context(mock.patch.dict(os.environ, {"MPLBACKEND": os.environ.get("MPLBACKEND", "Agg")}))
    stack.callback(random.setstate, python)
    stack.callback(np.random.set_state, shared)
    stack.callback(_forget, modules, folder)
    if threading.current_thread() is threading.main_thread():
      for number in (signal.SIGINT, signal.SIGTERM):
        stack.callback(signal.signal, number, signal.getsignal(number))
    yield


def _forget(before: set[str], folder: str) -> None:
  """Drop the script's own modules, so that another script in another folder has its own of the same name."""
  for name in set(sys.modules) - before:
    if str(getattr(sys.modules[name], "__file__", None) or "").startswith(folder + os.sep):
      del sys.modules[name]
