"""`kill -9` at random moments of a command: `python -m tests.faults.kills --help`.

After every kill each file in the folder of results has to be whole. A rerun has to end with what a run that nobody
stopped ends with: the same files, and in those that hold results the same numbers but for times of day and durations.
"""

import argparse
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import onnx
from safetensors.numpy import load_file

from tests import ROOT
from tests.scripts.tiny_session import write

TIMES = {"seconds", "stages", "sha256", "resumed"}  # keys of what no two runs have in common


@dataclass(frozen=True)
class Victim:
  """A command that is killed.

  Attributes:
    words: its arguments; {data} and {out} are filled in.  again: those of a rerun, where they differ.
    results: files whose numbers have to be those of a run that nobody stopped.
    chain: whether kills follow each other in one folder; else each has a folder of its own.
  """

  words: str
  again: str = ""
  results: tuple[str, ...] = ()
  chain: bool = False


VICTIMS = {
  "calibrate": Victim(
    "calibrate --dataset {data} --out {out} --quick --against recordings --threads 1",
    results=("calibration.json", "twin.toml"),
  ),
  "diagnose": Victim(
    "diagnose --dataset {data} --out {out} --quick --threads 1 --curves never", results=("diagnosis.json", "twin.toml")
  ),
  "campaign": Victim(
    "campaign --out {out} --seed 3 --nulls 1 --singles 1 --pairs 0 --outside 0 --jobs 1 --design paper",
    results=("null_00.json", "single_00.json"),
    chain=True,
  ),
  "train": Victim("train --out {out} --quick", "train --out {out} --resume", chain=True),
}


def start(words: str, **places: Path) -> subprocess.Popen[bytes]:
  """The command in a group of processes of its own."""
  command = [sys.executable, "-m", "scripts", *words.format(**places).split()]
  environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
  return subprocess.Popen(
    command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
  )


def finish(words: str, **places: Path) -> float:
  """Run it to its end; s that it took. Raises RuntimeError with what it said where it failed."""
  began = time.perf_counter()
  process = start(words, **places)
  said, _ = process.communicate()
  if process.returncode:
    raise RuntimeError(f"{words}: ended with {process.returncode}\n{said.decode(errors='replace')[-3000:]}")
  return time.perf_counter() - began


def kill_after(seconds: float, words: str, **places: Path) -> bool:
  """Run it for so long, then kill it with all its processes; whether it was still running."""
  process = start(words, **places)
  try:
    process.communicate(timeout=seconds)
    return False
  except subprocess.TimeoutExpired:
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    return True


def broken(folder: Path) -> list[str]:
  """Files in a folder that are not whole, and why; what a killed writer had begun is hidden and no result."""
  damage = []
  for path in sorted(folder.rglob("*")):
    if path.is_file() and not any(part.startswith(".writing-") for part in path.relative_to(folder).parts):
      try:
        _parse(path)
      except Exception as error:  # whatever a parser raises
        damage.append(f"{path.relative_to(folder)}: {type(error).__name__}: {error}")
  return damage


def _parse(path: Path) -> None:
  """Read a file to its end, by its kind."""
  kind, data = path.suffix, path.read_bytes()
  if kind == ".json":
    json.loads(data)
  elif kind == ".toml":
    tomllib.loads(data.decode())
  elif kind == ".html":
    assert data.rstrip().endswith(b"</html>"), "cut off"
  elif kind == ".png":
    assert matplotlib.image.imread(path).size
  elif kind == ".csv":
    assert len({len(row) for row in csv.reader(data.decode().splitlines())}) == 1, "rows of different lengths"
    assert data.endswith(b"\n"), "cut off"
  elif kind == ".npz":
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as arrays:
      assert all(arrays[name].shape is not None for name in arrays.files)
  elif kind == ".safetensors":
    load_file(path)
  elif kind == ".onnx":
    onnx.checker.check_model(onnx.load_from_string(data))
  elif kind == ".md":
    assert data.decode().endswith("\n") or data, "empty"
  else:
    assert path.name.startswith("events.out.tfevents"), "of a kind that nobody looks at"


def numbers(path: Path) -> Any:
  """What a file of results holds, without times."""
  text = path.read_text(encoding="utf-8")
  return _timeless(tomllib.loads(text) if path.suffix == ".toml" else json.loads(text))


def _timeless(value: Any) -> Any:
  if isinstance(value, dict):
    return {key: _timeless(item) for key, item in value.items() if key not in TIMES}
  return [_timeless(item) for item in value] if isinstance(value, list) else value


def names(folder: Path) -> set[str]:
  """Files of a folder, but for the time in the name of an event log and the step in that of a checkpoint."""
  files = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
  return {"events" if "tfevents" in path.name else path.name for path in files}


def differences(victim: Victim, whole: Path, resumed: Path) -> list[str]:
  """What a resumed run leaves that differs from what a run that nobody stopped leaves."""
  different = [f"files: {sorted(names(whole) ^ names(resumed))}"] if names(whole) != names(resumed) else []
  different += [f"left behind: {path}" for path in resumed.rglob(".writing-*")]
  return different + [name for name in victim.results if numbers(whole / name) != numbers(resumed / name)]


@dataclass
class Tally:
  """Kills that hit a running command, folders with a broken file, reruns, and those with another result."""

  kills: int = 0
  broken: int = 0
  reruns: int = 0
  different: int = 0
  seconds: float = 0.0


def torment(name: str, kills: int, every: int, seed: int, work: Path, data: Path) -> tuple[Tally, list[str]]:
  """Kill a command at random moments; compare after every so many kills (a chain: whenever it came to its end)."""
  victim, random, tally, said = VICTIMS[name], np.random.default_rng(seed), Tally(), []
  whole = work / "whole"
  tally.seconds = finish(victim.words, data=data, out=whole)
  out = work / "killed"
  words = lambda: victim.again if victim.again and (out / "training.json").is_file() else victim.words
  for number in range(1, kills + 1):
    hit = kill_after(random.uniform(0.1, 1.0) * tally.seconds, words(), data=data, out=out)
    tally.kills += hit
    if damage := broken(out):
      tally.broken += 1
      said += [f"{name}, kill {number}: {line}" for line in damage]
    ended = victim.chain and not hit  # what the kills before had left was gone on with, to the end
    if ended or (number == kills if victim.chain else number % every == 0):
      finish(words(), data=data, out=out)
      tally.reruns += 1
      damage = broken(out) + differences(victim, whole, out)
      tally.different += bool(damage)
      said += [f"{name}, rerun after kill {number}: {line}" for line in damage]
    if ended or not victim.chain:
      shutil.rmtree(out, ignore_errors=True)
  return tally, said


def main() -> None:
  """Torment the commands asked for and print a row of a Markdown table for each, faults below."""
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--commands", nargs="*", default=list(VICTIMS), help="which; all by default")
  parser.add_argument("--kills", type=int, default=20, help="of each")
  parser.add_argument("--every", type=int, default=1, help="kills between two reruns, where each has its own folder")
  parser.add_argument("--seed", type=int, default=1, help="of the moments")
  asked = parser.parse_args()
  print("| command | s undisturbed | kills | folders with a broken file | reruns | another result |")
  print("|---|---|---|---|---|---|")
  faults = []
  with tempfile.TemporaryDirectory() as folder:
    data = Path(folder) / "data"
    write(data)
    for name in asked.commands:
      tally, said = torment(name, asked.kills, asked.every, asked.seed, Path(folder) / name, data)
      faults += said
      counts = f"{tally.kills} | {tally.broken} | {tally.reruns} | {tally.different}"
      print(f"| {name} | {tally.seconds:.0f} | {counts} |", flush=True)
  print("\n".join(["", *faults]))
  raise SystemExit(bool(faults))


if __name__ == "__main__":
  main()
