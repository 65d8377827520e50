"""While a script runs, clocks, waiting, locks and threads of Python's library go by the simulated clock.

Only threads of the script notice. Whoever else calls gets the machine's clock and ordinary locks, also from what was
made while a script ran and outlives it.
"""

import functools
import multiprocessing.process
import os
import queue
import selectors
import subprocess
import threading
import time
from _thread import allocate_lock
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest import mock

from qcar_twin.onboard.clock import Clock, DriveOver

EPOCH = 1577836800.0  # s, what `time.time` says when a drive begins: 2020-01-01, the same for every drive
_SHORTEST = 1e-5  # s of a sleep of nothing, so that whoever polls gets on
_PROCESSES = ("system", "fork", "forkpty", "posix_spawn", "posix_spawnp", "execv", "execve")  # all others call these
_SELECTORS = [
  getattr(selectors, name) for name in ("SelectSelector", "PollSelector", "EpollSelector", "KqueueSelector")
  if hasattr(selectors, name)
]  # fmt: skip


class NoProcesses(OSError):
  """A script wanted to start another process. Libraries that only try one, for a list of fonts, go on without."""


class SimulatedLock:
  """A lock whose waiting takes simulated time."""

  def __init__(self, clock: Clock):
    self._clock, self._lock = clock, allocate_lock()

  def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
    """As `threading.Lock.acquire`."""
    if self._clock.current() is None:
      return self._lock.acquire(blocking, timeout)
    self._clock.pass_moment()
    if self._lock.acquire(False):
      return True
    if not blocking:
      return False
    return self._clock.wait_for(lambda: self._lock.acquire(False), None if timeout < 0 else timeout)

  def release(self) -> None:
    """As `threading.Lock.release`."""
    self._lock.release()

  def locked(self) -> bool:
    """Whether somebody holds it."""
    return self._lock.locked()

  def _at_fork_reinit(self) -> None:
    self._lock = allocate_lock()

  def __enter__(self) -> bool:
    return self.acquire()

  def __exit__(self, *_: object) -> None:
    self.release()


@contextmanager
def simulated_time(clock: Clock) -> Iterator[None]:
  """Let the calling thread, and the threads it starts, live on a clock."""
  make_lock = functools.partial(SimulatedLock, clock)
  monotonic = _reading(clock, time.monotonic, lambda t: t)
  stand_ins: list[tuple[Any, str, Any]] = [
    (time, "time", _reading(clock, time.time, lambda t: EPOCH + t)),
    (time, "time_ns", _reading(clock, time.time_ns, lambda t: round(1e9 * (EPOCH + t)))),
    (time, "perf_counter", _reading(clock, time.perf_counter, lambda t: t)),
    (time, "perf_counter_ns", _reading(clock, time.perf_counter_ns, lambda t: round(1e9 * t))),
    (time, "monotonic", monotonic),
    (time, "monotonic_ns", _reading(clock, time.monotonic_ns, lambda t: round(1e9 * t))),
    (time, "process_time", _reading(clock, time.process_time, lambda t: t)),
    (time, "sleep", _sleep(clock, time.sleep)),
    (threading, "_time", monotonic),
    (threading, "_allocate_lock", make_lock),
    (threading, "Lock", make_lock),
    (threading, "RLock", threading._PyRLock),  # type: ignore[attr-defined]  # made of the locks above
    (threading.Thread, "start", _start(clock, threading.Thread.start)),
    (threading.Thread, "join", _join(clock, threading.Thread.join)),
    (threading.Thread, "is_alive", _is_alive(clock, threading.Thread.is_alive)),
    (threading.Event, "is_set", _is_set(clock, threading.Event.is_set)),
    (queue, "time", monotonic),
    (queue, "SimpleQueue", queue._PySimpleQueue),  # type: ignore[attr-defined]
    *((time, name, _dated(clock, getattr(time, name))) for name in ("localtime", "gmtime", "ctime")),
    (time, "strftime", _written(clock, time.strftime)),
    *((kind, "select", _select(clock, kind.select)) for kind in _SELECTORS),
    (multiprocessing.process.BaseProcess, "start", _no_process),
    (subprocess.Popen, "__init__", _alone(clock, subprocess.Popen.__init__)),
    *((os, name, _alone(clock, getattr(os, name))) for name in _PROCESSES if hasattr(os, name)),
  ]
  with ExitStack() as stack:
    for owner, name, stand_in in stand_ins:
      stack.enter_context(mock.patch.object(owner, name, stand_in))
    yield


def _reading(clock: Clock, machine: Callable[[], Any], shown: Callable[[float], Any]) -> Callable[[], Any]:
  """A clock that threads of the script read."""
  return lambda: machine() if clock.current() is None else shown(clock.read())


def _dated(clock: Clock, machine: Callable[..., Any]) -> Callable[..., Any]:
  """A clock's date; of seconds that are given, theirs."""
  return lambda secs=None: machine(time.time() if secs is None and clock.current() is not None else secs)


def _written(clock: Clock, machine: Callable[..., str]) -> Callable[..., str]:
  """The same in words."""
  return lambda form, *when: machine(form, *(when or ([time.localtime()] if clock.current() is not None else [])))


def _select(clock: Clock, machine: Callable[..., list]) -> Callable[..., list]:
  """What waits for files and timers, as an event loop does: the wait takes simulated time."""

  def select(selector: Any, timeout: float | None = None) -> list:
    if clock.current() is None:
      return machine(selector, timeout)
    ready = machine(selector, 0)
    if ready or (timeout is not None and timeout <= 0):
      return ready
    clock.wait_for(lambda: bool(machine(selector, 0)), timeout)
    return machine(selector, 0)

  return select


def _sleep(clock: Clock, machine: Callable[[float], None]) -> Callable[[float], None]:
  def sleep(seconds: float) -> None:
    if clock.current() is None:
      machine(seconds)
    elif seconds < 0:
      raise ValueError("sleep length must be non-negative")
    else:
      clock.sleep_until(clock.now + max(float(seconds), _SHORTEST))

  return sleep


def _start(clock: Clock, machine: Callable[[threading.Thread], None]) -> Callable[[threading.Thread], None]:
  """Threads that the script starts take turns."""

  def start(thread: threading.Thread) -> None:
    if clock.current() is None or getattr(thread, "_clock_member", None) is not None:
      machine(thread)
      return
    member, run = clock.admit(thread.name, thread.daemon), thread.run

    def take_turns() -> None:
      try:
        clock.enter(member)
        run()
      except DriveOver:
        pass
      except SystemExit:
        pass
      except BaseException as error:
        clock.lost.append((thread.name, error))
      finally:
        clock.leave(member)

    vars(thread).update(run=take_turns, _clock_member=member, _daemonic=True)  # the process never waits for it
    with clock.outside():
      machine(thread)

  return start


def _join(clock: Clock, machine: Callable[..., None]) -> Callable[..., None]:
  def join(thread: threading.Thread, timeout: float | None = None) -> None:
    member = getattr(thread, "_clock_member", None)
    if member is None or clock.current() is None:
      machine(thread, timeout)
    elif clock.current() is member:
      raise RuntimeError("cannot join current thread")
    else:
      clock.wait_for(lambda: member.finished, timeout)

  return join


def _is_set(clock: Clock, machine: Callable[[threading.Event], bool]) -> Callable[[threading.Event], bool]:
  """Looking at an event takes a moment, as looking at a clock does: scripts wait by it."""

  def is_set(event: threading.Event) -> bool:
    if clock.current() is not None:
      clock.read()
    return machine(event)

  return is_set


def _is_alive(clock: Clock, machine: Callable[[threading.Thread], bool]) -> Callable[[threading.Thread], bool]:
  def is_alive(thread: threading.Thread) -> bool:
    if clock.current() is not None:
      clock.read()
    member = getattr(thread, "_clock_member", None)
    return machine(thread) if member is None else not member.finished

  return is_alive


def _no_process(process: Any) -> None:
  raise NoProcesses(_REFUSED.format(process.name))


def _alone(clock: Clock, machine: Callable[..., Any]) -> Callable[..., Any]:
  """What starts another process, refused to the script."""

  def start(*arguments: Any, **options: Any) -> Any:
    if clock.current() is None:
      return machine(*arguments, **options)
    what = [a for a in (*arguments, options.get("args")) if isinstance(a, str | list | tuple)]
    command = what[0] if what else "a copy of itself"
    raise NoProcesses(_REFUSED.format(command if isinstance(command, str) else " ".join(map(str, command))))

  return start


_REFUSED = (
  "the script starts another process ({:.60}), which has no part in the simulated car; use a thread, or"
  " drive the script that the process runs by itself"
)
