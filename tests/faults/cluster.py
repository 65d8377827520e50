"""A campaign on a local Ray cluster that loses a computer: `python -m tests.faults.cluster --help`.

Two workers of one processor each take cases; when the first answer is there and both are at a case, one is lost without
a warning. Every case has to be answered once. Needs Ray (the extra `cluster`).
"""

import argparse
import json
import tempfile
import threading
import time
from pathlib import Path

from scripts import campaign


def main() -> None:
  """Run the campaign, lose a worker, and print a row of a Markdown table."""
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--cases", type=int, default=6, help="sessions without effects, of the shortest design")
  parser.add_argument("--seed", type=int, default=5, help="of the campaign")
  asked = parser.parse_args()
  # an extra that is not in the lock file
  import ray  # pyright: ignore[reportMissingImports]
  from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

  cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
  workers = [cluster.add_node(num_cpus=1) for _ in range(2)]
  ray.init(address=cluster.address, log_to_driver=False)
  cluster.wait_for_nodes()
  with tempfile.TemporaryDirectory() as folder:
    out = Path(folder)

    def strike() -> None:
      while not list(out.glob("null_*.json")):
        time.sleep(0.2)
      cluster.remove_node(workers[0], allow_graceful=False)

    threading.Thread(target=strike, daemon=True).start()
    began = time.perf_counter()
    counts = dict(nulls=asked.cases, singles=0, pairs=0, outside=0)
    campaign.main(campaign.Config(out=out, seed=asked.seed, design="paper", ray=True, **counts))
    took = time.perf_counter() - began
    answers = [json.loads(path.read_text(encoding="utf-8"))["case"]["name"] for path in sorted(out.glob("null_*.json"))]
  alive = sum(node["Alive"] for node in ray.nodes()) - 1  # but the head
  print("| cases | workers left of 2 | answers | answered once | s |\n|---|---|---|---|---|")
  print(f"| {asked.cases} | {alive} | {len(answers)} | {len(set(answers))} | {took:.0f} |")
  raise SystemExit(alive != 1 or sorted(answers) != [f"null_{k:02d}" for k in range(asked.cases)])


if __name__ == "__main__":
  main()
