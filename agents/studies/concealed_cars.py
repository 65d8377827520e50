"""What an agent gains from a diagnosis of its car: agents trained on several twins drive cars that conceal an effect.

A training and a drive is done when its file is there, so a study that is stopped goes on. A reference drives the same
car without its effect: what remains then has other causes. The gap that a twin may close is the error of the agent of
the recalibrated twin less the reference's.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from joblib import delayed
from numpy.typing import NDArray

from agents.control.interface import Body, Controller
from agents.learning.by_reward import train_by_reward
from agents.learning.environments import options_from
from agents.learning.evaluate import EvaluationCase, run_together
from agents.learning.hyperparameters import Hyperparameters
from agents.learning.policy_file import load_policy
from agents.learning.trial import TRACKS, Trial
from agents.studies.comparison import LEFT, PATHS, paired
from agents.studies.side_by_side import side_by_side
from qcar_twin.atomic_io import write_json
from qcar_twin.estimation.settings import ESTIMATED
from qcar_twin.parallel import in_order
from qcar_twin.untrusted import read_json

Array = NDArray[np.float64]
REFERENCE = "without the effect"
BASELINE = "recalibrated"  # whose error less the reference's is the gap
INFORMED = ", informed"  # of the nominal twin's agent and the controllers, once more with the repaired twin's filter
SPEED = 0.9  # m/s, the middle of what the agents are trained for
SEED = 8000  # of the sensors; no training has seen them
ONCE: dict[str, dict[str, Any]] = {
  "bicycle": {"plant": "bicycle"},
  "nominal": {},
  "randomised": {"randomise": "prior"},
}
"""Trained once, on what is known of any car: the single track, the nominal twin, the same with drawn parameters."""
OWN = ("recalibrated", "repaired", "posterior")
"""Trained for every car: on its twin before and after the repair, and on all that the diagnosis believes."""
ABOUT = {
  "bicycle": "the single track with a servo",
  "nominal": "the nominal twin",
  "nominal, informed": "the same agent; the filter knows the repaired twin",
  "randomised": "the nominal twin, parameters drawn from their priors",
  "recalibrated": "the twin recalibrated to the car; the filter knows it",
  "repaired": "the repaired twin; the filter knows it",
  "posterior": "models and parameters as the diagnosis believes in them; the filter knows the repaired twin",
}


def own_options(folder: Path) -> dict[str, dict[str, Any]]:
  """Of the agents that are trained for a car, from its diagnosis's folder; alike where a repair changed nothing."""
  recalibrated, repaired = (folder / f"{name}.toml" for name in (BASELINE, "twin"))
  same = _numbers(recalibrated) == _numbers(repaired)
  return {
    "recalibrated": {"twin": str(recalibrated), "informed": True},
    "repaired": {"twin": str(recalibrated if same else repaired), "informed": True},
    "posterior": {"randomise": "posterior", "diagnosis": str(folder), "informed": True},
  }


def _numbers(twin: Path) -> list[str]:
  """Lines of a twin file but for the note."""
  return [line for line in twin.read_text(encoding="utf-8").splitlines() if not line.startswith("note =")]


def train_agent(hyper: Hyperparameters, changes: Mapping[str, Any], seed: int, folder: Path) -> Path:
  """Train an agent whose environment differs so, unless that was done; its policy's folder.

  Nobody evaluates on the way, which would take twice as long as the training: with a learning rate that falls to
  nothing the last policy is about the best.
  """
  if not (folder / "result.json").is_file():
    base = options_from(hyper.env_kwargs) if hyper.env_kwargs else TRACKS
    options = dataclasses.replace(base, **{"unknown": ESTIMATED, **changes})
    critic = "truth" if hyper.algorithm == "ppo" else "own"
    trial = Trial(hyper, options, hyper.observation, seed, every=0, critic=critic)
    (folder / "training.json").unlink(missing_ok=True)  # of one that was stopped: it has no checkpoint to go on from
    train_by_reward(trial, folder, tensorboard=False)
  return folder / "best"


def train_once(hyper: Hyperparameters, folder: Path, seeds: Sequence[int], jobs: int) -> dict[str, list[Path]]:
  """Policies of the agents that are for no car in particular, one a seed; so many trainings at a time."""
  wanted = [(name, s) for name in ONCE for s in seeds]
  place = lambda name, s: folder / "agents" / name / f"seed{s}"
  trained = in_order([delayed(train_agent)(hyper, ONCE[n], s, place(n, s)) for n, s in wanted], jobs)
  policies: dict[str, list[Path]] = {}
  for (name, _), policy in zip(wanted, trained, strict=True):
    policies.setdefault(name, []).append(policy)
  return policies


def train_its_own(hyper: Hyperparameters, folder: Path, seeds: Sequence[tuple[int, int]]) -> dict[str, list[Path]]:
  """Policies of the agents of a car's twins, from its diagnosis's folder; equal twins have one agent.

  Args:
    hyper: of the training.
    folder: of the car's diagnosis.
    seeds: number of a training and the seed it draws from.
  """
  options = own_options(folder)
  first = {name: next(n for n, other in options.items() if other == what) for name, what in options.items()}
  place = lambda name, number: folder / "agents" / first[name] / f"seed{number}"
  return {n: [train_agent(hyper, what, s, place(n, k)) for k, s in seeds] for n, what in options.items()}


def drive_car(
  policies: Mapping[str, Sequence[Path]],
  diagnosed: Path,
  plants: Mapping[bool, Body],
  streams: int,
  baselines: Mapping[str, Controller],
  file: Path,
) -> dict[str, list[Any]]:
  """Cross-track RMSE of everybody on a car, m, (seeds, paths, streams); kept in a file, read from it where it is there.

  Args:
    policies: of every competitor, one a seed.
    diagnosed: folder of the car's diagnosis.
    plants: the car with its effect (True) and without (False); drives of each are one simulation.
    baselines: controllers that drive with the plain filter, and with that of the repaired twin.
  """
  if file.is_file():
    return read_json(file)
  repaired = str(diagnosed / "twin.toml")
  known = {BASELINE: str(diagnosed / f"{BASELINE}.toml"), "repaired": repaired, "posterior": repaired}
  groups: dict[tuple[bool, str], dict[tuple[str, int], Controller]] = {}
  join = lambda effect, file, name, drivers: groups.setdefault((effect, file), {}).update(
    {(name, k): driver for k, driver in enumerate(drivers)}
  )
  loaded = {name: [load_policy(place) for place in places] for name, places in policies.items()}
  for name, drivers in (loaded | {name: [driver] for name, driver in baselines.items()}).items():
    join(True, known.get(name, ""), name, drivers)
    if name == "nominal":
      join(False, "", REFERENCE, drivers)
    if name == "nominal" or name in baselines:
      join(True, repaired, name + INFORMED, drivers)
  driven: dict[str, list[Any]] = {}
  for effect in (True, False):
    who = [(known, drivers) for (also, known), drivers in groups.items() if also == effect]
    drives = [partial(_drive, drivers, path, known, streams) for known, drivers in who for path in PATHS]
    for rows in side_by_side(plants[effect], drives):
      for name, rmse in rows:
        driven.setdefault(name, []).append(rmse)
  shaped = {name: _by_seed(rows).tolist() for name, rows in driven.items()}
  write_json(file, shaped)
  return shaped


def _drive(
  drivers: Mapping[tuple[str, int], Controller], path: str, known: str, streams: int, cars: Body
) -> list[tuple[str, list[float]]]:
  """Names with their RMSE on a path, m, (streams,)."""
  case = EvaluationCase(path, "concealed", SPEED, cars=streams, seed=SEED, unknown=ESTIMATED, known_from=known)
  labelled = {f"{name} {k}": driver for (name, k), driver in drivers.items()}
  rows = run_together(labelled, case, lambda name: (cars, np.empty(0)))  # type: ignore[arg-type]
  left = lambda row: np.where(np.isfinite(row.kpis.rmse), row.kpis.rmse, LEFT).tolist()
  return [(name, left(row)) for (name, _), row in zip(drivers, rows, strict=True)]


def _by_seed(rows: list[Any]) -> Array:
  """Rows that came path by path, each with all seeds, seed by seed: (seeds, paths, streams)."""
  values = np.array(rows)
  return values.reshape(len(PATHS), -1, values.shape[-1]).swapaxes(0, 1)


@dataclasses.dataclass(frozen=True)
class Driven:
  """A car that was driven.

  Attributes:
    name: of the car and what it conceals.  null: whether it conceals nothing.
    verdict: of the diagnosis, a line.
    rmse: by competitor, m, (seeds, paths, streams).
  """

  name: str
  null: bool
  verdict: str
  rmse: Mapping[str, Array]

  def mean(self, name: str) -> Array:
    """Of a competitor over its seeds and the paths, m, (streams,)."""
    return self.rmse[name].mean(axis=(0, 1))

  @property
  def gap(self) -> Array:
    """Of every stream, m, (streams,)."""
    return self.mean(BASELINE) - self.mean(REFERENCE)

  @property
  def has_gap(self) -> bool:
    """Whether the gap's 95 % interval over the streams is above zero."""
    return paired(self.mean(BASELINE)[None], self.mean(REFERENCE)[None]).verdict == "more"

  def closed(self, name: str) -> float:
    """Share of the gap that an agent closes: 1 where it errs as the reference does, 0 as the recalibrated one's."""
    return float((self.mean(BASELINE) - self.mean(name)).mean() / self.gap.mean())


def read_car(name: str, null: bool, verdict: str, file: Path) -> Driven:
  """What `drive_car` kept."""
  table = json.loads(file.read_text(encoding="utf-8"))
  return Driven(name, null, verdict, {label: np.array(values) for label, values in table.items()})


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
  """Median, and the narrowest order statistics that hold it with at least 95 %; all values' range where there are few.

  P(x_(k) < median < x_(n + 1 - k)) = 1 - 2 sum_{i < k} C(n, i) / 2^n (David and Nagaraja, Order Statistics, 7.1).
  """
  ordered = np.sort(values)
  below, k = 0.5 ** len(ordered), 0
  chance = below
  while k + 1 < len(ordered) / 2.0:
    chance *= (len(ordered) - k) / (k + 1)
    if 2.0 * (below + chance) > 0.05:
      break
    below, k = below + chance, k + 1
  return float(np.median(ordered)), float(ordered[k]), float(ordered[-1 - k])


def in_markdown(cars: Sequence[Driven]) -> str:
  """Tables: RMSE of everybody on every car, differences from the recalibrated twin's agent, and what is closed."""
  names = [*(name for name in cars[0].rmse if name not in (*ABOUT, REFERENCE)), *ABOUT, REFERENCE]
  lines = ["Mean RMSE over O, infinity, C and all streams, mm; in the last column the gap, bold where it is one.", ""]
  lines += [f"| car | {' | '.join(names)} | gap |", "|---" * (len(names) + 2) + "|"]
  for car in cars:
    cells = " | ".join(f"{1e3 * car.mean(name).mean():.2f}" for name in names)
    gap = f"{1e3 * car.gap.mean():+.2f}"
    lines.append(f"| {car.name} | {cells} | {f'**{gap}**' if car.has_gap else gap} |")
  lines += ["", "What the diagnoses said:", "", *(f"* {car.name}: {car.verdict}" for car in cars)]
  for said, some in (
    ("conceal an effect", [c for c in cars if not c.null]),
    ("conceal nothing", [c for c in cars if c.null]),
  ):
    if len(some) > 1:
      lines += [
        "",
        f"RMSE less the recalibrated twin's agent's on {len(some)} cars that {said}, mm and its share, with the 95 %",
        *_differences(some, names),
      ]
  open_gaps = [car for car in cars if car.has_gap]
  lines += ["", f"Share of the gap that is closed, on the {len(open_gaps)} cars that have one:", ""]
  for name in ABOUT if open_gaps else ():
    middle, low, high = median_interval([car.closed(name) for car in open_gaps])
    lines.append(f"* {name}: median {100 * middle:.0f} % [{100 * low:.0f}, {100 * high:.0f}]")
  return "\n".join(lines) + "\n"


def _differences(cars: Sequence[Driven], names: Sequence[str]) -> list[str]:
  """Rows of a table, paired car by car."""
  lines = ["interval of the mean over cars:", "", "| agent of | difference |", "|---|---|"]
  own = np.array([car.mean(BASELINE).mean() for car in cars])[None]
  for name in names:
    if name != BASELINE:
      apart = paired(np.array([car.mean(name).mean() for car in cars])[None], own)
      share = 100.0 * apart.mean / own.mean()
      lines.append(f"| {name} | {1e3 * apart.mean:+.2f} ± {1e3 * apart.half_width:.2f} ({share:+.0f} %) |")
  return lines
