"""Reads a file in a process of its own, for libraries that damaged files bring down.

The process stays, its library loaded, and forks for every file: what reading one breaks ends with it. Numbers come back
as plain bytes over a pipe, names and errors as JSON; nothing that a file holds is ever executed.
Run as `python -m qcar_twin.recordings.formats.apart MODULE`, it is that process.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import IO, Any

import numpy as np

from qcar_twin.recordings.recording import RecordingError
from qcar_twin.untrusted import bounded_memory

try:
  import resource
except ImportError:  # Windows has no limits for a process
  resource = None

Group = tuple[np.ndarray | None, dict[str, np.ndarray]]  # a clock (k,) or None, and columns (k,) by name
OBJECTS = "\0objects"  # a column that says: the file holds objects, which this reader cannot read
SECONDS = 8  # of processor time that reading may take, and one more for every MiB of the file
PATIENCE = 10  # times as long by the clock: a reader can wait for ever for what damage took from it
ROOT = str(Path(__file__).resolve().parents[3])
_KINDS: dict[str, type[Exception]] = {"recording": RecordingError, "memory": MemoryError, "system": OSError}
_lock = threading.Lock()
_processes: dict[tuple[str, int], subprocess.Popen[bytes]] = {}  # by module, and by whose child it is: forks differ


class ReaderEnded(Exception):
  """The process that read a file did not live to answer; the text says what ended it."""


def read_apart(module: str, path: Path, label: str) -> list[Group]:
  """What `module.groups(path, label)` yields, in a process with bounds: that module is not imported here.

  Raises ReaderEnded (a signal, its time), and what the reader raised: RecordingError, MemoryError, OSError, and
  ValueError for any other kind.
  """
  with _lock:
    process = _running(module)
    try:
      answer = _answered(process, path, label)
    except BaseException:  # the next file would get what is left of this answer
      _end(process)
      raise
  if isinstance(answer, Exception):
    raise answer
  return answer


def _running(module: str) -> subprocess.Popen[bytes]:
  key = (module, os.getpid())
  if key in _processes and _processes[key].poll() is not None:
    _end(_processes.pop(key))
  if key not in _processes:
    paths = os.pathsep.join([ROOT, *filter(None, [os.environ.get("PYTHONPATH")])])
    _processes[key] = subprocess.Popen(
      [sys.executable, "-P", "-m", "qcar_twin.recordings.formats.apart", module],  # -P: no modules from where one is
      env=os.environ | {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
      stdin=subprocess.PIPE,
      stdout=subprocess.PIPE,
    )
  return _processes[key]


def _answered(process: subprocess.Popen[bytes], path: Path, label: str) -> list[Group] | Exception:
  assert process.stdin is not None and process.stdout is not None
  try:
    process.stdin.write(json.dumps({"path": str(path.absolute()), "label": label}).encode() + b"\n")
    process.stdin.flush()
  except BrokenPipeError as error:
    raise ReaderEnded("its reader cannot be started") from error
  head = _line(process)
  if "ended" in head:
    raise ReaderEnded(_cause(head["ended"]))
  groups: list[Group] = []
  for names, sizes, clocked in head.get("groups", ()):
    columns = [_filled(np.empty(size), process) for size in sizes]
    clock = columns.pop(0) if clocked else None
    groups.append((clock, dict(zip(names, columns, strict=True))))
  if ended := _line(process).get("ended", 1):
    raise ReaderEnded(_cause(ended))
  return _KINDS.get(head["failed"], ValueError)(head["said"]) if "failed" in head else groups


def _line(process: subprocess.Popen[bytes]) -> dict[str, Any]:
  assert process.stdout is not None
  line = process.stdout.readline()
  try:
    content = json.loads(line)
  except ValueError as error:
    raise ReaderEnded("its reader ended in the middle of its answer") from error
  return content if isinstance(content, dict) else {}


def _filled(column: np.ndarray, process: subprocess.Popen[bytes]) -> np.ndarray:
  assert process.stdout is not None
  view, done = column.view(np.uint8), 0
  while done < view.size:
    if not (count := process.stdout.readinto(view[done:].data)):  # type: ignore[attr-defined]
      raise ReaderEnded("its reader ended in the middle of its answer")
    done += count
  return column


def _cause(ended: int) -> str:
  if -ended in (signal.SIGALRM, getattr(signal, "SIGXCPU", None)):
    return f"reading it takes more than {SECONDS} s and one for every MiB"
  if ended < 0:
    return f"it brings its reader down, {signal.Signals(-ended).name}"
  return f"its reader ended with {ended}"


def _end(process: subprocess.Popen[bytes]) -> None:
  process.kill()
  for pipe in (process.stdin, process.stdout):
    if pipe is not None:
      try:
        pipe.close()
      except BrokenPipeError:  # what was not yet sent
        pass
  process.wait()


@atexit.register
def end_all() -> None:
  """End the reading processes of this process; the next file gets a new one."""
  for key in [key for key in _processes if key[1] == os.getpid()]:
    _end(_processes.pop(key))


# ---------------------------------------------------------------- in the process that reads


def main(module: str) -> None:
  """Answer every line of JSON on the standard input until it is closed or a reader came down."""
  signal.signal(signal.SIGINT, signal.SIG_IGN)  # the asking process gets it, too, and ends this one
  out = os.fdopen(os.dup(1), "wb")
  os.dup2(2, 1)  # what a library prints is no answer
  if resource is not None:
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (hard, hard))  # inherited from the reading of one file
  read = import_module(module).groups
  for line in sys.stdin:
    request = json.loads(line)
    path, label = Path(request["path"]), request["label"]
    ended = _forked(read, path, label, out) if hasattr(os, "fork") else _answer(read, path, label, out)
    out.write(json.dumps({"ended": ended}).encode() + b"\n")
    out.flush()
    if ended:  # perhaps in the middle of an answer
      return


def _forked(read: Callable[[Path, str], Iterable[Group]], path: Path, label: str, out: IO[bytes]) -> int:
  """Answer from a fork; its exit code, or the signal that ended it as a negative number."""
  child = os.fork()
  if child:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
  ended = 1
  try:
    quiet = os.open(os.devnull, os.O_RDWR)
    for stream in (1, 2):  # the C library says something before it gives up
      os.dup2(quiet, stream)
    _bound(SECONDS + (path.stat().st_size >> 20))
    ended = _answer(read, path, label, out)
  finally:
    os._exit(ended)


def _bound(seconds: int) -> None:
  signal.signal(signal.SIGINT, signal.SIG_DFL)
  signal.alarm(PATIENCE * seconds)
  if resource is not None:
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds if hard == resource.RLIM_INFINITY else min(seconds, hard), hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _answer(read: Callable[[Path, str], Iterable[Group]], path: Path, label: str, out: IO[bytes]) -> int:
  """One line of JSON, then all columns one after the other as doubles, the clock of a group first."""
  listed, arrays = [], []
  try:
    with bounded_memory(path.stat().st_size):
      for clock, columns in read(path, label):
        parts = [*([] if clock is None else [clock]), *columns.values()]
        arrays += [np.ascontiguousarray(part, dtype=np.float64) for part in parts]
        listed.append((list(columns), [part.size for part in parts], clock is not None))
    head: dict[str, Any] = {"groups": listed}
  except Exception as error:  # readers raise many kinds for damaged files
    kind = next((name for name, known in _KINDS.items() if isinstance(error, known)), "other")
    head, arrays = {"failed": kind, "said": str(error)}, []
  out.write(json.dumps(head).encode() + b"\n")
  for array in arrays:
    out.write(array.view(np.uint8).data)
  out.flush()
  return 0


if __name__ == "__main__":
  main(sys.argv[1])
