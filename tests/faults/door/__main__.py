"""False logs of every source through `new`, `check` and `calibrate`: what was right, refused, warned of, or passed.

Sources are drives by formula of four sizes, sessions of both independent cars and the real sets of ../shared/data,
which are left out where they are absent. Every second log has a stranger's names and is read as `new` drafts it.

python -m tests.faults.door --count 400 --sound 60 --seed 1
"""

import argparse
import collections
import sys
import time

import numpy as np

from qcar_twin.recordings.recording import RecordingError
from tests.faults.door.outcomes import Outcome, Truth, outcome, read
from tests.faults.door.sources import sound, sources
from tests.faults.falsities import EVERY, Falsity

CHECKED, FITTED = ("right", "refused", "warned", "passed wrongly"), ("same", "refused", "warned", "differs")
Case = tuple[str, Falsity, Outcome]  # source, falsity, what became of it


def truths(seed: int, only: str = "") -> tuple[list[Truth], list[str]]:
  """Every source read both ways, and what is left out and why."""
  logs, absent = sources(seed)
  made = []
  for name, log in logs.items():
    for drafted in (False, True):
      if only not in name:
        continue
      try:
        made.append(Truth.of(log, drafted))
      except RecordingError as error:
        absent.append(f"{name}, drafted: {error}" if drafted else f"{name}: {error}")
  return made, absent


def driven(truth: Truth) -> bool:
  """Whether a car drove it: what a formula draws has geometry, and no dynamics that could be fitted."""
  return not truth.log.source.startswith("formula")


def label(truth: Truth) -> str:
  return f"{truth.log.source}{', drafted' if truth.drafted else ''}"


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--count", type=int, default=400, help="False logs.")
  parser.add_argument("--sound", type=int, default=60, help="Sound logs.")
  parser.add_argument("--seed", type=int, default=1, help="Of drives, sessions and which falsity meets which log.")
  parser.add_argument("--source", default="", help="Only sources whose name holds this.")
  parser.add_argument("--fits", type=int, default=40, help="At most so many calibrations, of the first that pass.")
  config = parser.parse_args()
  made, absent = truths(config.seed, config.source)
  print("\n".join(f"left out: {why}" for why in absent))
  took, cases = collections.Counter(), []
  fits = 0
  for number, (truth, falsity) in enumerate(dealt(made, config.count, config.seed), 1):
    began = time.perf_counter()
    cases.append((label(truth), falsity, outcome(falsity, truth, fits < config.fits and driven(truth))))
    fits += bool(cases[-1][2].calibrated)
    took[label(truth)] += time.perf_counter() - began
    print(f"{number} of {config.count}: {cases[-1][0]}: {falsity.name}: {cases[-1][2]}", file=sys.stderr, flush=True)
  print_tables(cases, took)
  print_sound(config.sound, config.seed)


def dealt(made: list[Truth], count: int, seed: int) -> list[tuple[Truth, Falsity]]:
  """Every source in turn, each with falsities in an order of its own, of channels that it has."""
  random, hands = np.random.default_rng(seed), []
  for truth in made:
    fit = [f for f in EVERY if f.applies(truth.log.channels)]
    hands.append([fit[k] for k in random.permutation(len(fit))])
  return [(made[k % len(made)], _nth(hands[k % len(made)], k // len(made))) for k in range(count)]


def _nth(hand: list[Falsity], number: int) -> Falsity:
  return hand[number % len(hand)]


def print_tables(cases: list[Case], took: collections.Counter) -> None:
  """Outcomes by source and by falsity, and all that passed wrongly or was fitted otherwise."""
  for title, key in (("source", lambda case: case[0]), ("falsity", lambda case: case[1].name)):
    rows = collections.defaultdict(list)
    for case in cases:
      rows[key(case)].append(case[2])
    timed = " s |" if title == "source" else ""
    print(f"\n| {title} | " + " | ".join((*CHECKED, *(f"fit: {kind}" for kind in FITTED))) + f" |{timed}")
    print("|---" * (9 + bool(timed)) + "|")
    for name, outcomes in {**rows, "all": [case[2] for case in cases]}.items():
      counts = [sum(o.checked == kind for o in outcomes) for kind in CHECKED]
      counts += [sum(o.calibrated == kind for o in outcomes) for kind in FITTED]
      seconds = took[name] if name != "all" else sum(took.values())
      print(f"| {name} | " + " | ".join(map(str, counts)) + " |" + (f" {seconds:.0f} |" if timed else ""))
  print()
  for source, falsity, o in cases:
    if o.checked == "passed wrongly" or o.calibrated == "differs":
      print(f"{source}: {falsity.name}: {o.checked}, fit {o.calibrated or 'not made'}: {o.said}")


def print_sound(count: int, seed: int) -> None:
  """False alarms on sound logs: refusals and findings that spoil."""
  alarms = []
  logs = sound(count, seed)
  for log, drafted in logs:
    try:
      said = [f.text for f in read(log, drafted).of("spoils")]
    except RecordingError as error:
      said = [str(error)]
    alarms += [f"{log.source}{', drafted' if drafted else ''}: {said[0]}"] if said else []
  print(f"false alarms on {len(logs)} sound logs: {len(alarms)}")
  print("\n".join(alarms))


if __name__ == "__main__":
  main()
