"""Every call once, wherever it is made and whatever is killed meanwhile."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from joblib import delayed

from qcar_twin.atomic_io import write_text
from qcar_twin.parallel import WorkerLost, in_order, in_parallel


def who(number: int, wait: float = 0.0) -> tuple[int, int]:
  time.sleep(wait)
  return number, os.getpid()


def fail(number: int) -> int:
  raise ValueError(f"call {number} cannot be")


def die(number: int) -> int:
  os.kill(os.getpid(), signal.SIGKILL)
  return number


def answer(folder: Path, number: int) -> int:
  """A case that takes a while; leaves its answer, and a line for every time it was begun and ended."""
  with open(folder / "begun.txt", "a", encoding="utf-8") as file:
    file.write(f"{number}\n")
  time.sleep(3.0)
  write_text(folder / f"case_{number:02d}.json", f'{{"answer": {number}}}')
  return number


def test_work_is_done_in_other_processes_and_comes_back_in_order():
  results = in_order([delayed(who)(k) for k in range(6)], workers=2)
  assert [number for number, _ in results] == list(range(6))
  assert os.getpid() not in {process for _, process in results}


def test_results_come_as_they_are_done_each_with_its_place():
  results = list(in_parallel([delayed(who)(k, 1.0 if k == 0 else 0.0) for k in range(4)], workers=2))
  assert sorted(index for index, _ in results) == list(range(4)) and results[-1][0] == 0
  assert all(index == number for index, (number, _) in results)


def test_one_worker_is_this_process():
  assert in_order([delayed(who)(3)]) == [(3, os.getpid())]


def test_what_a_call_raises_is_raised():
  with pytest.raises(ValueError, match="call 1 cannot be"):
    in_order([delayed(fail)(1)], workers=2)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_worker_that_was_killed_is_said_in_a_sentence():
  with pytest.raises(WorkerLost, match="run the same command again with fewer processes"):
    in_order([delayed(die)(k) for k in range(4)], workers=2)


CLUSTER = """
import os, signal, sys, threading, time
from pathlib import Path
import ray
from ray.cluster_utils import Cluster
from joblib import delayed
from qcar_twin.parallel import in_parallel
from tests.qcar_twin.test_parallel import answer

folder = Path(sys.argv[1])
cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
nodes = [cluster.add_node(num_cpus=2) for _ in range(2)]
ray.init(address=cluster.address, log_to_driver=False)
cluster.wait_for_nodes()
begun, answered = (lambda: len((folder / "begun.txt").read_text().split())), (lambda: len(list(folder.glob("case*"))))
def strike():
  while begun() - answered() < 3:  # with two processors each, both workers are at a case then
    time.sleep(0.05)
  cluster.remove_node(nodes[0], allow_graceful=False)
(folder / "begun.txt").touch()
threading.Thread(target=strike).start()
found = [index for index, number in in_parallel([delayed(answer)(folder, k) for k in range(12)], ray=True)]
print("alive", sum(node["Alive"] for node in ray.nodes()), "done", *found)
"""


@pytest.mark.slow
def test_a_lost_computer_of_a_cluster_costs_no_case_and_doubles_none(tmp_path):
  """Two workers, one killed while it is at a case."""
  pytest.importorskip("ray", reason="Ray is an extra: pip install qcar-twin[cluster]")
  command = [sys.executable, "-c", CLUSTER, str(tmp_path)]
  done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
  assert done.returncode == 0, done.stderr[-2000:]
  words = next(line for line in done.stdout.splitlines() if line.startswith("alive")).split()
  assert words[:2] == ["alive", "2"], "the head and one worker are left"
  assert sorted(map(int, words[3:])) == list(range(12)), "every case comes back once"
  assert len(list(tmp_path.glob("case_*.json"))) == 12
  begun = (tmp_path / "begun.txt").read_text().split()
  assert len(begun) > 12, "what the lost worker was at was begun again"


def test_no_processes_are_refused():
  with pytest.raises(ValueError, match="0 processes do nothing: give 1 or more"):
    in_order([], workers=0)
