"""Reads damaged files, each in a process of its own with bounds: `python -m tests.faults.fuzz --help`.

A reader has to end in a finite result or in one of this project's own errors that names the file, within 10 s of
processor time and 2 GB of memory. Anything else is a fault: another exception, a signal, a bound.
"""

import argparse
import logging
import os
import resource
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from commands.__main__ import PACKAGES
from tests.faults.mutations import damaged
from tests.faults.samples import KINDS

SECONDS, MEMORY, WALL = 10, 2e9, 120  # s of processor time, bytes, s of the clock on a busy machine
CLEAR, RIGHT = "clear error", "result"


@dataclass(frozen=True)
class Outcome:
  """How reading one file ended: CLEAR, RIGHT or what went wrong; what was said; s of processor time, bytes at most."""

  end: str
  said: str
  seconds: float
  memory: float

  @property
  def fault(self) -> bool:
    """Whether it breaks the promise."""
    return self.end not in (CLEAR, RIGHT) or self.seconds > SECONDS or self.memory > MEMORY


def apart(read: Callable[[], object], names: tuple[str, ...]) -> Outcome:
  """Read in a forked process and say how it ended; `names`: one of them has to be in an error's text."""
  ends, begins = os.pipe()
  child = os.fork()
  if child == 0:
    os.close(ends)
    _bound()
    said = _ended(read, names)
    os.write(begins, "\n".join(said).encode(errors="replace")[:60000])
    os._exit(0)
  os.close(begins)
  with os.fdopen(ends, "rb") as pipe:
    text = pipe.read().decode(errors="replace")
  _, status, used = os.wait4(child, 0)
  if os.WIFSIGNALED(status):
    text = f"killed by {signal.Signals(os.WTERMSIG(status)).name}\n{text}"
  end, _, said = text.partition("\n")
  return Outcome(end, said, used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss)


def _bound() -> None:
  """Bounds of this process; its output goes nowhere."""
  quiet = os.open(os.devnull, os.O_RDWR)
  for stream in (1, 2):
    os.dup2(quiet, stream)
  resource.setrlimit(resource.RLIMIT_CPU, (SECONDS + 1, SECONDS + 2))
  resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
  signal.alarm(WALL)
  logging.disable(logging.CRITICAL)
  warnings.simplefilter("ignore")


def _ended(read: Callable[[], object], names: tuple[str, ...]) -> tuple[str, str]:
  try:
    result = read()
  except Exception as error:
    said = str(error)
    if type(error).__module__.partition(".")[0] not in PACKAGES:
      return f"another error: {type(error).__name__}", traceback.format_exc()
    if not any(name in said for name in names):
      return "an error without the file's name", traceback.format_exc()
    return ("an error of several lines" if "\n" in said.strip() else CLEAR), said
  arrays = result if isinstance(result, list) else [result]
  if not all(np.isfinite(np.asarray(a, dtype=float)).all() for a in arrays if not isinstance(a, str)):
    return "a result that is not finite", repr(result)[:2000]
  return RIGHT, ""


def fuzz(name: str, count: int, seed: int, folder: Path) -> Iterator[tuple[int, Outcome]]:
  """Damage a kind of file `count` times; yields each file's seed and how reading it ended."""
  kind, good = KINDS[name], folder / "good"
  good.mkdir(parents=True)
  files = kind.make(good)
  if (whole := apart(lambda: kind.read(good), ("",))).end != RIGHT:
    raise ValueError(f"{name}: the undamaged file cannot be read: {whole.said}")
  tried = folder / "tried"
  for number in range(count):
    own = seed * 1_000_000 + number
    file = files[number % len(files)]
    shutil.copytree(good, tried)
    (tried / file).write_bytes(damaged((good / file).read_bytes(), own, kind.text))
    names = (*(path.stem for path in good.rglob("*")), "recording name")
    yield own, apart(lambda: kind.read(tried), names)
    shutil.rmtree(tried)


def main() -> None:
  """Fuzz the kinds asked for and print what came of them as rows of a Markdown table, faults below it."""
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--kinds", nargs="*", default=list(KINDS), help="kinds of files; all by default")
  parser.add_argument("--count", type=int, default=2000, help="damaged files of each")
  parser.add_argument("--seed", type=int, default=1, help="of the damage")
  asked = parser.parse_args()
  print("| file | damaged | right result | clear error | faults | most s | most MB | wall s |")
  print("|---|---|---|---|---|---|---|---|")
  faults = []
  for name in asked.kinds:
    began, ends, slowest, largest = time.perf_counter(), Counter(), 0.0, 0.0
    with tempfile.TemporaryDirectory() as folder:
      for own, outcome in fuzz(name, asked.count, asked.seed, Path(folder)):
        ends[outcome.end if not outcome.fault else "fault"] += 1
        slowest, largest = max(slowest, outcome.seconds), max(largest, outcome.memory)
        if outcome.fault:
          faults.append(
            f"{name} {own}: {outcome.end}, {outcome.seconds:.1f} s, {outcome.memory / 1e6:.0f} MB\n{outcome.said}"
          )
    figures = f"{slowest:.2f} | {largest / 1e6:.0f} | {time.perf_counter() - began:.0f}"
    print(f"| {name} | {asked.count} | {ends[RIGHT]} | {ends[CLEAR]} | {ends['fault']} | {figures} |", flush=True)
  print("\n".join(["", *faults]))
  raise SystemExit(bool(faults))


if __name__ == "__main__":
  main()
