"""Simulated time: whose turn it is, what waiting costs, how a script is stopped, the same course every time."""

import concurrent.futures
import queue
import signal
import threading
import time
from collections.abc import Callable

import pytest

from qcar_twin.onboard.clock import Clock, Deadlock, DriveOver
from qcar_twin.onboard.standing_in import EPOCH, simulated_time


@pytest.fixture(autouse=True)
def the_interrupt_is_heard():
  """A shell that starts something in the background has it ignore Ctrl-C, and a clock goes by that."""
  here = signal.signal(signal.SIGINT, signal.default_int_handler)
  yield
  signal.signal(signal.SIGINT, here)


def run(part: Callable[[], object], limit: float = 100.0, move: Callable[[float], None] = lambda _: None) -> Clock:
  """Do something on a clock of its own, to the end of all its threads."""
  clock = Clock(move, limit)
  with simulated_time(clock), clock.main():
    try:
      part()
      clock.finish()
    finally:
      clock.end()
  return clock


def test_sleeping_costs_nothing_and_every_clock_tells_the_same_time():
  said = []

  def part():
    time.sleep(50.0)
    said.extend([time.time() - EPOCH, time.perf_counter(), time.monotonic(), time.time_ns() / 1e9 - EPOCH])

  begun = time.perf_counter()
  assert run(part).now == pytest.approx(50.0, abs=1e-4)
  assert time.perf_counter() - begun < 5.0
  assert said == pytest.approx([50.0] * 4, abs=1e-4)


def test_a_loop_that_waits_busily_comes_to_its_end():
  def part():
    until = time.perf_counter() + 10.0
    while time.perf_counter() < until:
      pass

  assert run(part).now == pytest.approx(10.0, abs=1e-3)


def test_whoever_wakes_first_goes_first_and_ties_go_by_arrival():
  order = []

  def sleeper(name: str, seconds: float) -> None:
    time.sleep(seconds)
    order.append(name)

  def part():
    threads = [threading.Thread(target=sleeper, args=job) for job in (("c", 3.0), ("a", 1.0), ("b", 1.0))]
    for thread in threads:
      thread.start()
    for thread in threads:
      thread.join()

  run(part)
  assert order == ["a", "b", "c"]


def test_locks_events_queues_and_pools_wait_on_simulated_time():
  said = {}

  def part():
    lock, event, box = threading.Lock(), threading.Event(), queue.Queue()

    def other():
      with lock:
        time.sleep(2.0)
      event.set()
      time.sleep(1.0)
      box.put("here")

    thread = threading.Thread(target=other)
    thread.start()
    time.sleep(0.5)
    said["refused"] = lock.acquire(timeout=0.5), round(time.monotonic(), 3)
    with lock:
      said["lock"] = round(time.monotonic(), 3)
    said["event"] = event.wait(5.0), round(time.monotonic(), 3)
    said["queue"] = box.get(timeout=9.0), round(time.monotonic(), 3)
    with pytest.raises(queue.Empty):
      box.get(timeout=1.0)
    said["empty"] = round(time.monotonic(), 3)
    thread.join()
    said["alive"] = thread.is_alive()
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
      said["pool"] = list(pool.map(lambda s: (time.sleep(s), s)[1], (2.0, 1.0)))

  run(part)
  assert said == {
    "refused": (False, 1.0),
    "lock": 2.0,
    "event": (True, 2.0),
    "queue": ("here", 3.0),
    "empty": 4.0,
    "alive": False,
    "pool": [2.0, 1.0],
  }


def test_threads_take_the_same_course_every_time():
  def course() -> list[tuple[str, float]]:
    seen = []

    def worker(name: str, every: float) -> None:
      for _ in range(40):
        seen.append((name, time.perf_counter()))
        time.sleep(every)

    def part():
      for name, every in (("a", 0.013), ("b", 0.007), ("c", 0.013)):
        threading.Thread(target=worker, args=(name, every)).start()

    run(part)
    return seen

  first = course()
  assert len(first) == 120 and all(course() == first for _ in range(5))


@pytest.mark.parametrize("before", [signal.default_int_handler, signal.SIG_DFL, signal.SIG_IGN])
def test_at_the_limit_the_script_is_interrupted_and_may_tidy_up(before):
  """Whatever Ctrl-C did where the command was started: a shell's background ignores it."""
  said = []

  def part():
    try:
      while True:
        time.sleep(0.01)
    except KeyboardInterrupt:
      time.sleep(1.0)
      said.append(round(time.monotonic(), 6))

  here = signal.signal(signal.SIGINT, before)
  try:
    clock = run(part, limit=5.0)
  finally:
    signal.signal(signal.SIGINT, here)
  assert clock.stopped and said == [pytest.approx(6.0, abs=1e-4)]


def test_a_script_that_ignores_the_interrupt_goes_on_until_the_grace_is_spent():
  def part():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
      time.sleep(0.5)

  with pytest.raises(DriveOver):
    run(part, limit=2.0)


def test_who_does_not_heed_the_interrupt_is_ended_when_the_grace_is_spent():
  def part():
    while True:
      try:
        time.sleep(0.5)
      except KeyboardInterrupt:
        pass

  with pytest.raises(DriveOver):
    run(part, limit=2.0)


def test_threads_that_outlive_the_script_are_ended():
  ended = []

  def forever():
    try:
      while True:
        time.sleep(0.1)
    except DriveOver:
      ended.append("told")
      raise

  def stubborn():
    while True:
      try:
        time.sleep(0.1)
      except BaseException:
        ended.append("caught")

  def part():
    for target in (forever, stubborn):
      threading.Thread(target=target, daemon=True).start()
    time.sleep(1.0)

  assert run(part).now == pytest.approx(1.0, abs=1e-3)
  assert "told" in ended and 1 < ended.count("caught") < 100


def test_a_thread_that_keeps_a_program_alive_is_waited_for():
  said = []

  def late():
    time.sleep(3.0)
    said.append("done")

  assert run(lambda: threading.Thread(target=late).start()).now == pytest.approx(3.0, abs=1e-3)
  assert said == ["done"]


def test_threads_that_wait_for_each_other_are_said_to():
  with pytest.raises(Deadlock, match="waits for another one"):
    run(lambda: threading.Event().wait())


def test_the_car_is_moved_as_time_passes_and_its_failure_ends_the_script():
  moved = []

  def move(time: float) -> None:
    moved.append(time)
    if time > 1.0:
      raise ArithmeticError("came apart")

  clock = Clock(move, 100.0)
  with simulated_time(clock), clock.main():
    with pytest.raises(DriveOver):
      while True:
        time.sleep(0.25)
    clock.end()
  assert moved[:4] == pytest.approx([0.25, 0.5, 0.75, 1.0], abs=1e-4)
  assert str(clock.failure) == "came apart"


def test_nothing_is_left_in_place_afterwards():
  before = time.time, time.sleep, threading.Lock, threading.RLock, threading.Thread.start, queue.SimpleQueue
  kept = {}

  def part():
    kept.update(lock=threading.Lock(), condition=threading.Condition(), now=time.time)

  run(part)
  assert before == (time.time, time.sleep, threading.Lock, threading.RLock, threading.Thread.start, queue.SimpleQueue)
  assert kept["lock"].acquire(timeout=0.01) and not kept["lock"].acquire(timeout=0.01)
  assert kept["now"]() == pytest.approx(time.time(), abs=5.0)  # what outlives a drive goes by the machine
  with kept["condition"]:
    assert not kept["condition"].wait(0.01)


def test_real_time_passes_no_faster_than_on_the_wall():
  clock, begun = Clock(lambda _: None, 100.0, real_time=True), time.perf_counter()
  with simulated_time(clock), clock.main():
    time.sleep(0.3)
    clock.end()
  assert time.perf_counter() - begun >= 0.3
