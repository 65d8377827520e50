"""One executor for whatever is done many times over: joblib's processes here, or the tasks of a Ray cluster.

  for index, result in in_parallel([delayed(drive)(case) for case in cases], workers=2): ...

Results come as they are done, each exactly once. On Ray a call whose worker or computer is lost is made again on
another; a call that writes files has to write them whole (`qcar_twin.atomic_io`), into a folder that all workers share.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from qcar_twin.extras import extra

Call = tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]  # what joblib's `delayed` makes


class WorkerLost(RuntimeError):
  """A process that worked was killed from outside; what was finished before is kept."""


def in_parallel(calls: Sequence[Call], workers: int = 1, ray: bool = False) -> Iterator[tuple[int, Any]]:
  """Make every call once; yields (its place in `calls`, its result) as they are done.

  Args:
    calls: of `joblib.delayed`.
    workers: processes; a Ray cluster takes as many calls at a time as it has processors.
    ray: send the calls to the Ray cluster at hand (RAY_ADDRESS), or to a local one, instead of local processes.

  Raises:
    ValueError: no workers.
    WorkerLost: a local process was killed, for want of memory most likely. What a call raises is raised here.
  """
  if workers == 0:
    raise ValueError("0 processes do nothing: give 1 or more, or -1 for one a core")
  if ray:
    yield from _on_ray(calls)
    return
  numbered = (joblib.delayed(_numbered)(index, call) for index, call in enumerate(calls))
  try:
    results: Any = joblib.Parallel(n_jobs=workers, return_as="generator_unordered")(numbered)
    yield from results
  except BrokenProcessPool as error:
    raise WorkerLost(
      "a worker process was killed, for want of memory most likely; run the same command again with fewer processes"
    ) from error


def in_order(calls: Sequence[Call], workers: int = 1, ray: bool = False) -> list[Any]:
  """Results in the order of the calls; otherwise as `in_parallel`."""
  results = dict(in_parallel(calls, workers, ray))
  return [results[index] for index in range(len(calls))]


def _numbered(index: int, call: Call) -> tuple[int, Any]:
  function, arguments, named = call
  return index, function(*arguments, **named)


def _on_ray(calls: Sequence[Call]) -> Iterator[tuple[int, Any]]:
  with extra("A Ray cluster"):  # not in the lock file: checked where it is installed
    import ray as cluster  # pyright: ignore[reportMissingImports]

  if not cluster.is_initialized():
    cluster.init(address=os.environ.get("RAY_ADDRESS"), include_dashboard=False, log_to_driver=False)
  task = cluster.remote(max_retries=-1)(_numbered)  # again for a lost worker; what a call raises is no loss
  under_way = [task.remote(index, call) for index, call in enumerate(calls)]
  while under_way:
    done, under_way = cluster.wait(under_way, num_returns=1)
    yield from cluster.get(done)
