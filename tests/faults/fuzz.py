"""Reads damaged files in processes of their own with bounds: `python -m tests.faults.fuzz --help`.

A reader has to end in a finite result or in one of this project's own errors that names the file, within 10 s of
processor time and 1.7 GB of memory beyond what the process held before: 2 GB where it had only imported the readers.
Anything else is a fault: another exception, a signal, a bound.
"""

import argparse
import gc
import json
import logging
import os
import resource
import signal
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TextIO

import numpy as np

from qcar_twin.command_line import PACKAGES
from tests.faults.mutations import damaged
from tests.faults.samples import KINDS

SECONDS, MEMORY, WALL = 10, 1.7e9, 120  # s of processor time, bytes, s of the clock on a busy machine
BATCH = 100  # files that one process reads as long as it lives
CLEAR, RIGHT = "clear error", "result"


@dataclass(frozen=True)
class Outcome:
  """How reading one file ended: CLEAR, RIGHT or what went wrong; what was said; s of processor time, bytes it took."""

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
  return next(one_by_one([read], names))


def one_by_one(reads: Sequence[Callable[[], object]], names: tuple[str, ...]) -> Iterator[Outcome]:
  """Read one after the other in a forked process, and in a fresh one after a reader that brought its own down."""
  todo = list(reads)
  while todo:
    ends, begins = os.pipe()
    child = os.fork()
    if child == 0:
      gc.freeze()  # a batch of an earlier test, collected here, would wait for threads that were not forked
      os.close(ends)
      with os.fdopen(begins, "w", encoding="utf-8", errors="replace") as pipe:
        _read_all(todo, names, pipe)
      os._exit(0)
    os.close(begins)
    with os.fdopen(ends, encoding="utf-8", errors="replace") as pipe:
      for line in pipe:
        yield Outcome(**json.loads(line))
        del todo[0]
    _, status, used = os.wait4(child, 0)
    if os.WIFSIGNALED(status):
      name = signal.Signals(os.WTERMSIG(status)).name
      yield Outcome(f"killed by {name}", "", used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss)
      del todo[0]


def _memory(field: str) -> float:
  """A field of this process's status, bytes."""
  lines = Path("/proc/self/status").read_text().splitlines()
  return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith(field))


def _read_all(reads: Sequence[Callable[[], object]], names: tuple[str, ...], pipe: TextIO) -> None:
  """In the forked process: a line of JSON for every reader; its output goes nowhere."""
  quiet = os.open(os.devnull, os.O_RDWR)
  for stream in (1, 2):
    os.dup2(quiet, stream)
  resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
  logging.disable(logging.CRITICAL)
  warnings.simplefilter("ignore")
  for read in reads:
    began = time.process_time()
    resource.setrlimit(resource.RLIMIT_CPU, (int(began) + SECONDS + 1, resource.RLIM_INFINITY))
    signal.alarm(WALL)
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory starts anew
    held = _memory("VmRSS")  # a process that has run other tests has their memory, too
    end, said = _ended(read, names)
    outcome = Outcome(end, said[:20000], time.process_time() - began, _memory("VmHWM") - held)
    pipe.write(json.dumps(asdict(outcome)) + "\n")
    pipe.flush()


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
  names = (*(path.stem for path in good.rglob("*")), "recording name")
  contents = {file: (good / file).read_bytes() for file in files}
  seeds = [seed * 1_000_000 + number for number in range(count)]

  def read(number: int) -> object:
    file = files[number % len(files)]
    for name, content in contents.items():
      (good / name).write_bytes(damaged(content, seeds[number], kind.text) if name == file else content)
    return kind.read(good)

  for start in range(0, count, BATCH):
    some = range(start, min(start + BATCH, count))
    yield from zip(seeds[start:], one_by_one([partial(read, number) for number in some], names), strict=False)


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
