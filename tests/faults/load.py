"""Long logs and many recordings: `python -m tests.faults.load --help`.

A car is driven for so many sessions in the laboratory of the proving ground, and every recording cut into pieces by
`from` and `to`, as somebody does who marks the runs in a long log. Then commands run on it, each in a process of its
own, and their time and memory are told.
"""

import argparse
import os
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path

from tests import ROOT

COMMANDS = (
  "check --dataset {data} --out {out}",
  "calibrate --dataset {data} --out {out} --against recordings --threads 1",
  "diagnose --dataset {data} --out {out} --threads 1 --curves never",
)
SHORTEST = 1.0  # s: a shorter rest stays with the piece before it


def run(words: Sequence[str]) -> tuple[float, float, float]:
  """A command to its end: s of wall, s of the processor, and the most memory of its largest process, bytes.

  Raises:
    RuntimeError: it failed.
  """
  began, (ends, begins) = time.perf_counter(), os.pipe()
  child = os.fork()
  if child == 0:
    os.dup2(begins, 1)
    os.dup2(begins, 2)
    os.chdir(ROOT)
    settings = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    os.execve(sys.executable, [sys.executable, "-m", "scripts", *words], settings)
  os.close(begins)
  with os.fdopen(ends, encoding="utf-8", errors="replace") as pipe:
    said = pipe.read()
  _, status, used = os.wait4(child, 0)
  if status:
    raise RuntimeError(f"{' '.join(words)}: ended with {os.waitstatus_to_exitcode(status)}\n{said[-3000:]}")
  return time.perf_counter() - began, used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss


def cut(folder: Path, length: float) -> tuple[int, float]:
  """Cut every recording of a data set into pieces of so many s; how many there are, and s of driving."""
  path = folder / "dataset.toml"
  head, *entries = path.read_text(encoding="utf-8").split("[[recording]]\n")
  told = tomllib.loads(path.read_text(encoding="utf-8"))["recording"]
  pieces, driven = [], 0.0
  for entry, known in zip(entries, told, strict=True):
    rows = (folder / known["file"]).read_text(encoding="utf-8").splitlines()
    first, last = (float(row.split(",")[0]) for row in (rows[1], rows[-1]))
    count = max(int((last - first) / length + 1.0 - SHORTEST / length), 1)
    driven += last - first
    kept = [line for line in entry.splitlines() if line.strip() and not line.startswith("name")]
    for k in range(count):
      begin, end = first + k * length, last if k == count - 1 else first + (k + 1) * length
      own = [f'name = "{known["name"]}_{k}"', f"from = {begin:.3f}", f"to = {end:.3f}"]
      pieces.append("\n".join(["[[recording]]", *kept, *own, ""]))
  path.write_text(head + "\n".join(pieces), encoding="utf-8")
  return len(pieces), driven


def main() -> None:
  """Make the recordings, run the commands and print a row of a Markdown table for each."""
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--sessions", type=int, default=12, help="of five minutes each")
  parser.add_argument("--piece", type=float, default=3.5, help="s of a recording")
  parser.add_argument("--seed", type=int, default=31, help="of the car")
  asked = parser.parse_args()
  with tempfile.TemporaryDirectory() as folder:
    data = Path(folder) / "data"
    making = f"make-session --out {data} --seed {asked.seed} --effect steering_delay --sessions {asked.sessions}"
    run(making.split())
    count, driven = cut(data, asked.piece)
    print("| recordings | min of driving | command | s of wall | s of the processor | GB |\n|---|---|---|---|---|---|")
    for words in COMMANDS:
      wall, used, memory = run(words.format(data=data, out=Path(folder) / "out").split())
      said = f"{wall:.0f} | {used:.0f} | {memory / 1e9:.1f}"
      print(f"| {count} | {driven / 60.0:.0f} | {words.split()[0]} | {said} |", flush=True)


if __name__ == "__main__":
  main()
