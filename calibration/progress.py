"""How a long run says what it is doing: the protocol, and "stage x of y · what · time left" on the terminal."""

import logging
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType, TracebackType
from typing import Protocol, TextIO, TypeVar

from tqdm import tqdm

Item = TypeVar("Item")


class Progress(Protocol):
  """Receives the stage a run has reached, and the share of it that is done, 0 to 1, where that is known."""

  def __call__(self, stage: str, share: float | None = None, /) -> None: ...


_QUIET = 60.0  # s without a line, after which a log says how far a stage is


def silent(stage: str, share: float | None = None) -> None:
  """A `Progress` that says nothing."""


Plan = Mapping[str, float]
"""Stages in their order, by how their text begins ("fit|recalibration": one of these), and about how long each takes.

Only ratios of the durations count, for the time left; they are seconds of data/sample on two cores, and those of free
curves the seconds of a car whose mismatch stayed unexplained. 0: not foreseen, or not always run.
"""

NONE: Plan = MappingProxyType({})
CHECK: Plan = MappingProxyType({"noise and timing": 1.0, "two sensors of one motion": 1.0})
CALIBRATION: Plan = MappingProxyType({"identification": 6.0, "recalibration|fit ": 65.0, "comparison": 7.0})
CROSS_VALIDATION: Plan = MappingProxyType(
  {"identification ": 1.0, "windows of": 3.0, "free run": 2.0, "where the models part": 2.0}
)
DIAGNOSIS: Plan = MappingProxyType(
  {
    "recalibration": 65.0,
    "scan": 10.0,
    "refitting single mechanisms": 53.0,
    "refitting pairs": 24.0,
    "refitting triples": 4.0,
    "polishing the best model": 73.0,
    "decision": 54.0,
    "location": 0.5,
    "hold-out": 1.0,
    "formula for the rest": 0.0,
    "film and report": 19.0,
    "free curves": 0.0,
  }
)
CURVES: Plan = MappingProxyType(
  {
    "the base as it is": 51.0,
    "curves": 185.0,
    "names for": 64.0,
    "named effects": 55.0,
    "what else the named effects may be": 47.0,
    "what the twin does as well without": 30.0,
    "fitting what is named to the end": 71.0,
    "fitting to what judged": 65.0,
    "hold-out": 5.0,
  }
)


def joined(*plans: Plan) -> Plan:
  """One plan after the other; a stage that several have is distinguished by spaces, which do not show."""
  whole: dict[str, float] = {}
  for plan in plans:
    for name, seconds in plan.items():
      while name in whole:
        name += " "
      whole[name] = seconds
  return whole


def under(name: str, plan: Plan) -> Plan:
  """The stages of one of several runs: "sample: identification"."""
  return {"|".join(f"{name}: {start.strip()}" for start in stage.split("|")): s for stage, s in plan.items()}


def within(name: str, progress: Progress) -> Progress:
  """What such a run says its stages to."""
  return lambda stage, share=None: progress(f"{name}: {stage}", share)


def staged(
  results: Iterable[tuple[int, Item]], stages: Sequence[str], progress: Progress
) -> Iterator[tuple[int, Item]]:
  """Results of calls with their places, as `in_parallel` gives them; the stage is that of the first call not done.

  Args:
    stages: of each call, by its place.
  """
  left = dict(enumerate(stages))
  progress(stages[0])
  for place, result in results:
    yield place, result
    del left[place]
    if left:
      progress(next(iter(left.values())))


class Stages:
  """Where a run is within its plan, and how much longer it takes.

  A stage ends when a later one of the plan begins; texts that begin no later stage belong to the present one. Without a
  plan every new text is a stage.
  """

  def __init__(self, plan: Plan):
    self._names = [[start.strip() for start in name.split("|")] for name in plan]
    self._seconds = list(plan.values())
    self._at, self._share, self._began, self._last = -1, 0.0, time.monotonic(), ""
    self._entered = self._began  # the present stage

  def reached(self, text: str, share: float | None) -> bool:
    """Note what a run says; whether a stage of the plan begins with it."""
    if not self._names:
      self._last, before = text, self._last
      return text != before
    later = range(self._at + 1, len(self._names))
    at = next((k for k in later if any(text.startswith(start) for start in self._names[k])), None)
    if at is None:
      self._share = self._share if share is None else share
      return False
    self._at, self._share, self._entered = at, share or 0.0, time.monotonic()
    return True

  def line(self, text: str) -> str:
    """ "stage 2 of 10 · scan · about 3 min left"."""
    if self._at < 0:
      return text
    left = self.left
    return f"stage {self._at + 1} of {len(self._names)} · {text}" + (f" · {duration(left)} left" if left else "")

  @property
  def left(self) -> float | None:
    """Seconds, from how much longer than planned it took until now; None where nothing is known yet.

    A stage that says no share of itself goes at the pace of those before, and once it takes longer than that, as if it
    ended now. Of a stage that was not foreseen, from how much longer it took than its share; what follows goes at the
    pace before.
    """
    now, planned = time.monotonic(), self._seconds[self._at]
    before, after = sum(self._seconds[: self._at]), sum(self._seconds[self._at + 1 :])
    pace = (self._entered - self._began) / before if before > 0.0 else None
    if self._share > 0.0:
      rest = (now - self._entered) * (1.0 - self._share) / self._share
      if planned > 0.0:
        pace = (now - self._began) / (before + self._share * planned)
        rest = pace * (1.0 - self._share) * planned
      return rest + (pace or 0.0) * after
    if pace is None or planned <= 0.0:
      return None
    return (
      max(pace * planned - (now - self._entered), 0.0) + max(pace, (now - self._began) / (before + planned)) * after
    )


def duration(seconds: float) -> str:
  """ "about 40 s", "about 3 min"."""
  return f"about {max(seconds, 1.0):.0f} s" if seconds < 90.0 else f"about {seconds / 60.0:.0f} min"


class StageLine(logging.Handler):
  """A line on the terminal that is written over, with messages of the package's fits behind it.

  Where the output is no terminal each stage of the plan is one plain line, written once; one that takes minutes says
  about once in each for how long it has run.

  with StageLine(CALIBRATION) as progress:
    calibrate(dataset, progress=progress)

  It may be entered several times, for what is printed between: the stages go on.
  """

  def __init__(self, plan: Plan = NONE, logger: str = "calibration"):
    super().__init__(logging.INFO)
    self._logger, self._stages = logging.getLogger(logger), Stages(plan)
    self._bar: tqdm | None = None
    self._before, self._said, self._printed = (logging.NOTSET, True), "", time.monotonic()
    self._began = self._printed  # the stage

  def __enter__(self) -> "StageLine":
    if sys.stderr.isatty():
      self._bar = tqdm(total=0, bar_format="{elapsed} {desc}", dynamic_ncols=True)
    self._before = self._logger.level, self._logger.propagate
    self._logger.setLevel(logging.INFO)
    self._logger.propagate = False  # root's handlers would print every message of a fit between the lines
    self._logger.addHandler(self)
    return self

  def __call__(self, stage: str, share: float | None = None) -> None:
    """Show a stage, and in per cent how much of it is done."""
    if begins := self._stages.reached(stage, share):
      self._began = time.monotonic()
    self._said = stage if share is None else f"{stage}, {100.0 * share:.0f} %"
    if self._bar is not None:
      self._show(self._stages.line(self._said))
    elif begins:
      self._print(self._stages.line(stage))
    else:
      self._beat()

  def say(self, text: str) -> None:
    """Print a result above the stage."""
    tqdm.write(text)

  def emit(self, record: logging.LogRecord) -> None:
    """Show a message of a fit behind the stage; pass on what is more than a message."""
    if record.levelno == logging.INFO:
      self._show(f"{self._stages.line(self._said)}: {record.getMessage()}")
      self._beat()
    elif logging.root.isEnabledFor(record.levelno):
      logging.root.handle(record)

  def __exit__(
    self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
  ) -> None:
    self._logger.removeHandler(self)
    level, self._logger.propagate = self._before
    self._logger.setLevel(level)
    if self._bar is not None:
      self._bar.close()
      self._bar = None

  def _beat(self) -> None:
    """Where no terminal is: say how far a stage is that has said nothing for long."""
    if self._bar is None and self._said and time.monotonic() - self._printed > _QUIET:
      self._print(f"{self._stages.line(self._said)} · for {duration(time.monotonic() - self._began)}")

  def _print(self, text: str) -> None:
    print(text, file=sys.stderr, flush=True)
    self._printed = time.monotonic()

  def _show(self, text: str) -> None:
    if self._bar is not None:
      self._bar.set_description_str(text[:150])


def counted(items: Iterable[Item], total: int, what: str, stream: TextIO | None = None) -> Iterator[Item]:
  """The items, each shown when it is done: as a bar, or as "case 3 of 88 · about 40 min left" where no terminal is."""
  shown: TextIO = sys.stderr if stream is None else stream
  if shown.isatty():
    yield from tqdm(items, total=total, desc=f"{what}s", unit=what, file=shown)
    return
  began = time.monotonic()
  for done, item in enumerate(items, 1):
    left = (time.monotonic() - began) / done * (total - done)
    print(f"{what} {done} of {total} · {duration(left)} left", file=shown, flush=True)
    yield item
