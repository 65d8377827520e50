"""Simulated time for a script and its threads: one of them runs at a time, and time passes where they wait.

Threads of an ordinary program interleave as the machine pleases. Here a thread runs until it waits or reads a
clock; then the one whose turn is earliest goes on, ties in the order in which they came. So a script with threads
takes the same course every time, to the bit, and an hour of waiting costs nothing.
"""

import heapq
import itertools
import signal
import threading
import time as real
from _thread import allocate_lock, get_ident
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

READ_COST = 1e-6  # s that reading a clock takes; doubled every 16 readings in a row, so that busy waiting ends soon
GRACE = 5.0  # s that a script has after it was stopped, to bring its car to rest and write its files
_DOUBLINGS = 6
_REFUSALS = 20  # times that a thread is told to end before it is left standing
_sleep, _wall = real.sleep, real.perf_counter  # the machine's own, whatever stands in their place later


class DriveOver(BaseException):
  """Ends a thread of a script when the drive is over; not an Exception, so that `except Exception` lets it through."""


class Deadlock(RuntimeError):
  """Every thread of the script waits for another one."""


class Member:
  """A thread of the script, as the clock knows it."""

  def __init__(self, name: str, daemon: bool):
    self.name, self.daemon, self.finished = name, daemon, False
    self.turn = allocate_lock()  # held, except while the thread is being handed the turn
    self.turn.acquire()
    self.ticket = -1  # of its entry among the sleepers; an entry with another number is out of date
    self.condition: Callable[[], bool] | None = None
    self.met = False
    self.error: BaseException | None = None
    self.interrupted = False
    self.refusals = 0


class Clock:
  """Time of a drive and whose turn it is.

  Args:
    move: moves the car on to a time, s; never back.
    limit: s after which the script is stopped as by Ctrl-C, and `GRACE` later for good.
    real_time: whether time passes no faster than on the wall.
  """

  def __init__(self, move: Callable[[float], None], limit: float = float("inf"), real_time: bool = False):
    self.now, self.limit, self.touched = 0.0, limit, 0
    self.stopped = False  # whether the script was stopped at its limit
    self.over = False
    self.failure: Exception | None = None  # of the car
    self.asking = False  # whether a person is being asked, who may take their time
    self.lost: list[tuple[str, BaseException]] = []  # threads that ended in an error, by name
    self.running: Member | None = None
    self._move_car, self._real_time, self._begun = move, real_time, _wall()
    self._members: dict[int, Member] = {}
    self._all: list[Member] = []
    self._ready: deque[Member] = deque()
    self._sleeping: list[tuple[float, int, Member]] = []
    self._waiting: list[Member] = []
    self._tickets = itertools.count()
    self._in_a_row = 0
    self._local = threading.local()
    self._deaf = False  # whether Ctrl-C was ignored before the script began, as in a shell's background

  # -- who takes part ----------------------------------------------------------------------------

  def current(self) -> Member | None:
    """The calling thread where it is one of the script's, None for any other and within `outside`."""
    member = self._members.get(get_ident())
    return None if member is None or getattr(self._local, "outside", False) else member

  @contextmanager
  def outside(self) -> Iterator[None]:
    """What is done here is not the script's: clocks and locks are the machine's."""
    before = getattr(self._local, "outside", False)
    self._local.outside = True
    try:
      yield
    finally:
      self._local.outside = before

  @contextmanager
  def main(self) -> Iterator[Member]:
    """The calling thread is the script's main thread."""
    member = self._main = Member("main", False)
    self._members[get_ident()], self.running, self._begun = member, member, _wall()
    self._deaf = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    try:
      yield member
    finally:
      self._members.pop(get_ident(), None)
      self.over = True

  def admit(self, name: str, daemon: bool) -> Member:
    """A thread that is about to start; its turn comes after those that wait already."""
    member = Member(name, daemon)
    self._all.append(member)
    self._ready.append(member)
    return member

  def enter(self, member: Member) -> None:
    """Called in the new thread: wait for the first turn."""
    self._members[get_ident()] = member
    member.turn.acquire()
    self._resume(member)

  def leave(self, member: Member) -> None:
    """Called at the end of a thread: pass the turn on for the last time."""
    member.finished = True
    self._members.pop(get_ident(), None)
    self._hand_over(self._pick(self._main))

  def thread_of(self, member: Member) -> int | None:
    """Identity of the thread that a member is."""
    return next((ident for ident, known in self._members.items() if known is member), None)

  def finish(self) -> None:
    """The main thread is done: let the threads that keep a program alive end by themselves."""
    if not self.over:
      self.wait_for(lambda: all(m.finished or m.daemon for m in self._all), None)

  def end(self) -> None:
    """End every other thread at its next turn; called by the main thread when the script has ended."""
    self.over = True
    for member in self._all:
      if not member.finished:
        self._make_ready(member)
    while self._ready:
      member = self._ready.popleft()
      self._ready.append(self._main)
      self._hand_over(member)
      self._main.turn.acquire()
      self.running = self._main

  # -- waiting -----------------------------------------------------------------------------------

  def read(self) -> float:
    """The time, s since the start, for a thread that looks at a clock: that takes a moment, too."""
    self._in_a_row += 1
    self._sleep_until(self.now + READ_COST * 2 ** min(self._in_a_row // 16, _DOUBLINGS))
    return self.now

  def pass_moment(self) -> None:
    """Let whoever takes a lock spend a moment, so that a loop that only polls gets on, too."""
    self._sleep_until(self.now + READ_COST)

  def sleep_until(self, time: float) -> None:
    """Wait until a time, s."""
    self._in_a_row = 0
    self._sleep_until(time)

  def wait_for(self, condition: Callable[[], bool], timeout: float | None) -> bool:
    """Wait until a condition holds, which only other threads can bring about, or for `timeout` s; whether it holds."""
    me = self._me()
    if condition():
      return True
    self._in_a_row, me.condition, me.met = 0, condition, False
    self._waiting.append(me)
    if timeout is not None:
      self._enqueue(me, self.now + max(timeout, READ_COST))
    self._switch(me)
    return me.met

  def _sleep_until(self, time: float) -> None:
    me = self._me()
    alone = not (self._ready or self._waiting) and (not self._sleeping or self._sleeping[0][0] > time)
    if alone and time < self.limit:
      self._move(time)
      self._resume(me)
      return
    self._enqueue(me, time)
    self._switch(me)

  def _me(self) -> Member:
    member = self.current()
    if member is None:
      raise RuntimeError("only a thread of the script waits on the simulated clock")
    self.touched += 1
    self._resume(member)
    return member

  def _enqueue(self, member: Member, time: float) -> None:
    member.ticket = next(self._tickets)
    heapq.heappush(self._sleeping, (max(time, self.now), member.ticket, member))

  def _switch(self, me: Member) -> None:
    """Pass the turn on and wait for the next one."""
    following = self._pick(me)
    if following is not me:
      self._hand_over(following)
      me.turn.acquire()
    self.running = me
    self._resume(me)

  def _hand_over(self, member: Member) -> None:
    self.running = member
    member.turn.release()

  def _resume(self, me: Member) -> None:
    """What a thread meets when its turn has come."""
    if me.interrupted:
      me.interrupted = False
      _interrupt(self._deaf)
    if me.error is not None:
      error, me.error = me.error, None
      raise error
    if self.over and me is self._main:
      raise DriveOver
    if self.over:
      me.refusals += 1
      self._make_ready(self._main)
      if me.refusals > _REFUSALS:  # it catches everything: leave it standing, the process ends without it
        me.finished = True
        self._hand_over(self._pick(self._main))
        me.turn.acquire()
      raise DriveOver

  # -- whose turn it is --------------------------------------------------------------------------

  def _pick(self, me: Member) -> Member:
    """The thread whose turn is next; time passes until then."""
    while True:
      if self._ready:
        return self._settled(self._ready.popleft())
      for member in self._waiting:
        if member.condition is not None and member.condition():
          member.met = True
          return self._settled(member)
      while self._sleeping and self._sleeping[0][1] != self._sleeping[0][2].ticket:
        heapq.heappop(self._sleeping)
      due = self._sleeping[0][0] if self._sleeping else float("inf")
      if not self._sleeping:
        self._main.error = Deadlock("every thread of the script waits for another one")
        return self._settled(self._main)
      if due >= self.limit:
        self._stop()
      else:
        _, _, member = heapq.heappop(self._sleeping)
        self._move(due)
        return self._settled(member)

  def _settled(self, member: Member) -> Member:
    """A thread that waits for nothing any more."""
    member.ticket, member.condition = -1, None
    if member in self._waiting:
      self._waiting.remove(member)
    return member

  def _make_ready(self, member: Member) -> None:
    self._settled(member)
    if member not in self._ready:
      self._ready.append(member)

  def _stop(self) -> None:
    """At the limit: Ctrl-C for the main thread, and the end for it when its grace is spent, too."""
    self._move(self.limit)
    self._make_ready(self._main)
    if self.stopped:
      self.over, self.limit = True, float("inf")
    else:
      self.stopped, self._main.interrupted, self.limit = True, True, self.limit + GRACE

  def _move(self, time: float) -> None:
    if self.failure is not None:
      return
    if self._real_time:
      _sleep(max(time - (_wall() - self._begun), 0.0))
    try:
      with self.outside():
        self._move_car(time)
    except Exception as error:
      self.failure, self.over = error, True
    self.now = max(self.now, time)


def _interrupt(deaf: bool) -> None:
  """What Ctrl-C does: the script's own answer where it has one; to ignore it is none where that was so before."""
  answer = signal.getsignal(signal.SIGINT)
  if callable(answer):
    answer(signal.SIGINT, None)
  elif deaf or answer is not signal.SIG_IGN:
    raise KeyboardInterrupt
