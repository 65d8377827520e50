"""A loop's timer under the name that scripts import; simulated time, since `time` is."""

import time


class Timer:
  """Keeps a loop at a rate: `while timer.check(): ...; timer.sleep()`.

  Args:
    sampleRate: Hz.
    totalTime: s after which `check` says that it is over.
    verbose: makes no difference.
  """

  def __init__(self, sampleRate: float, totalTime: float, verbose: bool = False):
    if not sampleRate > 0:
      raise ValueError(f"Timer: sampleRate is in Hz, not {sampleRate!r}")
    self._period, self._total, self._rounds = 1.0 / sampleRate, totalTime, 0
    self._begun = time.time()
    self._now, self._took = 0.0, self._period

  def check(self) -> bool:
    """Begin a round; False when the time is over."""
    now = time.time() - self._begun
    self._took, self._now = (now - self._now if self._rounds else self._period), now
    return now < self._total

  def get_current_time(self) -> float:
    """When this round began, s."""
    return self._now

  def get_sample_time(self) -> float:
    """Between the beginnings of the last two rounds, s."""
    return self._took

  def sleep(self) -> None:
    """Wait for the next round."""
    self._rounds += 1
    time.sleep(max(self._begun + self._rounds * self._period - time.time(), 0.0))
