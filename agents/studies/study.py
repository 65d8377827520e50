"""The study of the results page as jobs that can be done one by one: trainings of every variant and seed, then drives.

A job is done when its file is there. Trainings go to VARIANT/seedK (and are resumed from their last checkpoint), drives
to evaluated/SETTING/GROUP.json, where a group is the controllers or a variant with the seeds that were driven; a drive
with more seeds replaces one with fewer.
"""

import dataclasses
import json
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.control.kpis import Kpis
from agents.learning.ddpg import Settings
from agents.learning.environments import Options, PlantName
from agents.learning.evaluate import EvaluationCase, PlantMaker, Row, contestants, known_plant, run_together
from agents.learning.observation import OBSERVATIONS
from agents.learning.train import Plan, train
from agents.learning.trial import DRAWN
from qcar_twin.atomic_io import write_text
from qcar_twin.cures import RENAMED_PLANTS
from qcar_twin.envs.task import Reward
from qcar_twin.recordings.recording import nearest

PATHS = ("o", "infinity", "c")
MISMATCH = (0.92, 1.0)  # steering gain -, offset deg, fixed before anything was trained
CONTROLLERS = "controllers"
WIDE = OBSERVATIONS["wide"]
BY_REWARD = ("hyperparameters", "observation", "critic", "workers", "device", "tensorboard")
NOT_IMITATED = (
  "episodes", "demonstrator", "version", "demonstrator_weight", "demonstrations", "near", "diagnosis",
)  # fmt: skip
"""Options of `qcar-twin train` that belong to a training by reward alone; and those that an imitation does not take."""
ALIKE = ("twin", "estimator", "unknown", "version", "steering_gain", "steering_offset", *DRAWN)


@dataclasses.dataclass(frozen=True)
class Variant:
  """A way of training.

  Attributes:
    about: in a line.
    plan: of an agent without its seed.
    twin: whether it waits for a twin file of its own name to train on.
    seconds: about how long a training takes, CPU (docs/results/learning.md).
  """

  about: str
  plan: Plan
  twin: bool = False
  seconds: float = 41.0


STANDARD = Plan(Options(version="tuned", reward=Reward(m6=1.0)))
ALONE = dataclasses.replace(STANDARD, options=Options(demonstrator="", reward=Reward(m6=0.0)))
WIDE_PLAN = Plan(
  Options(demonstrator="", reward=Reward(m6=0.0), gain_spread=0.1, offset_spread=1.5),
  Settings(episodes=0, imitations=72, mirror=True),
  observation=WIDE,
)
VARIANTS = {
  "standard": Variant(
    "the paper's agent: DDPG, four errors, LQ_ed tuned as demonstrator in the reward", STANDARD, seconds=324.0
  ),
  "alone": Variant("the same without the demonstrator's term r_ed", ALONE, seconds=74.0),
  "wide": Variant(
    (
      "sees also command, curvature and their slow means; imitates the linear rate policy that sees the truth, on "
      "linkages newly drawn every episode"
    ),
    WIDE_PLAN,
  ),
  "recalibrated": Variant("wide, trained on the twin recalibrated to the car with the effect", WIDE_PLAN, True, 84.0),
  "repaired": Variant("wide, trained on the twin the diagnosis repaired", WIDE_PLAN, True, 94.0),
}


def variant_named(name: str) -> Variant:
  """Raises KeyError where there is none, with the nearest one."""
  if name not in VARIANTS:
    raise KeyError(f"no variant '{name}'{nearest(name, VARIANTS)}")
  return VARIANTS[name]


def wide_plan(twin: str, plant: PlantName, seed: int, quick: bool = False) -> Plan:
  """The imitation of a teacher, on a twin file (or the nominal twin) and a plant."""
  settings = dataclasses.replace(WIDE_PLAN.settings, imitations=6 if quick else WIDE_PLAN.settings.imitations)
  options = dataclasses.replace(WIDE_PLAN.options, twin=twin, plant=plant)
  return dataclasses.replace(WIDE_PLAN, options=options, settings=settings, seed=seed)


def plan_from(asked: Mapping[str, Any], defaults: Mapping[str, Any]) -> Plan:
  """The paper's training, or the imitation, that options of `qcar-twin train`, by name, ask for.

  Raises:
    ValueError: an option is given that this training has no use for.
  """
  kind, foreign = ("imitation", NOT_IMITATED) if asked["wide"] else ("paper's training", ())
  if idle := [name for name in (*foreign, *BY_REWARD) if asked[name] != defaults[name]]:
    cure = "name an --algorithm" if idle[0] in BY_REWARD else "leave out --wide"
    raise ValueError(f"the {kind} has no use for --{idle[0].replace('_', '-')}: leave it out, or {cure}")
  plant, quick = "mujoco" if asked["plant"] == "auto" else asked["plant"], asked["quick"]
  if asked["wide"]:
    plan = wide_plan(asked["twin"], "bicycle" if quick else plant, asked["seed"], quick)
    taken = {name: asked[name] for name in ALIKE if name not in NOT_IMITATED} | {"path": asked["path"] or "s"}
    learning = dataclasses.replace(plan.settings, cars=asked["cars"])
    return dataclasses.replace(plan, options=dataclasses.replace(plan.options, **taken), settings=learning)
  alone = asked["demonstrator"] == "none"
  reward = Reward(near=asked["near"], m6=0.0 if alone else asked["demonstrator_weight"])
  taken = {name: asked[name] for name in ALIKE} | {"path": asked["path"] or "s", "reward": reward}
  options = Options(**taken, plant=plant, demonstrator="" if alone else asked["demonstrator"])
  learning = Settings(asked["episodes"], cars=asked["cars"], demonstrations=asked["demonstrations"])
  if quick:
    options = dataclasses.replace(options, plant="bicycle", estimator="truth")
    learning = dataclasses.replace(learning, episodes=min(learning.episodes, 24), warm_up=200, steps_per_update=32)
  return Plan(options, learning, asked["seed"], every=4 if quick else 15)


@dataclasses.dataclass(frozen=True)
class Setting:
  """Circumstances in which groups are driven on several paths.

  Attributes:
    cases: one per path.  groups: of VARIANTS, or CONTROLLERS.
    versions: of the controllers.
  """

  cases: tuple[EvaluationCase, ...]
  groups: tuple[str, ...]
  versions: tuple[str, ...] = ("tuned",)


def _cases(paths: Sequence[str] = PATHS, **circumstances: Any) -> tuple[EvaluationCase, ...]:
  return tuple(EvaluationCase(path, **circumstances) for path in paths)


def settings(
  cars: int = 8, speeds: Sequence[float] = (0.3, 0.7, 0.9, 1.2), plants: Sequence[str] = (), special: Sequence[str] = ()
) -> dict[str, Setting]:
  """What is driven, by name.

  Args:
    cars: runs of each contestant.
    speeds: m/s, besides 0.5.
    plants: by the names the plant maker knows, on which everybody is driven besides the twin.
    special: plants on which the agents trained on twins of their own are driven, too.
  """
  gain, offset = MISMATCH
  everyone = (CONTROLLERS, "standard", "alone", "wide")
  bent = _cases(steering_gain=gain, steering_offset=offset, cars=cars)
  known = {
    "N": Setting(_cases(cars=cars), everyone, ("loose", "tuned")),
    "MIS": Setting(bent, everyone, ("loose", "tuned")),
  }
  few = (CONTROLLERS, "standard", "wide")
  known |= {f"{speed:g} m/s": Setting(_cases(speed=speed, cars=max(2, cars // 2)), few) for speed in speeds}
  own = tuple(name for name, variant in VARIANTS.items() if variant.twin)
  for plant in (*plants, *special):
    groups = few + own * (plant in special)
    known[plant] = Setting(_cases(plant=plant, cars=max(2, cars // 2)), groups)
  return known


@dataclasses.dataclass(frozen=True)
class Job:
  """Something to do: `work` leaves `file`, whose presence says that it was done, and takes about so many seconds."""

  name: str
  file: Path
  work: Callable[[], Any]
  seconds: float = 11.0  # of driving a group, CPU (study --quick)


def timed(job: Job) -> tuple[float, float]:
  """Do a job; s of the clock and of the processor that it took."""
  began, cpu = time.perf_counter(), time.process_time()
  job.work()
  return time.perf_counter() - began, time.process_time() - cpu


def training_jobs(folder: Path, variant: str, seeds: Sequence[int], episodes: int | None = None) -> list[Job]:
  """One per seed; a variant that waits for its twin has none until folder/VARIANT.toml is there."""
  chosen = variant_named(variant)
  twin = folder / f"{variant}.toml"
  if chosen.twin and not twin.is_file():
    return []
  jobs = []
  for seed in seeds:
    plan = dataclasses.replace(chosen.plan, seed=seed)
    if chosen.twin:
      plan = dataclasses.replace(plan, options=dataclasses.replace(plan.options, twin=str(twin)))
    if episodes and not plan.settings.imitations:
      plan = dataclasses.replace(plan, settings=dataclasses.replace(plan.settings, episodes=episodes))
    target = folder / variant / f"seed{seed}"
    work = partial(warm_start, plan, target)
    jobs.append(Job(f"train {variant} {seed}", target / "result.json", work, chosen.seconds))
  return jobs


def warm_start(plan: Plan, folder: Path) -> dict[str, Any]:
  """Train into a folder, from its last checkpoint where it has one; a training without one begins again."""
  resumable = (folder / "checkpoint.json").is_file()
  if not resumable:
    (folder / "training.json").unlink(missing_ok=True)
  return train(plan, folder, resume=resumable)


def driving_jobs(folder: Path, name: str, setting: Setting, plant: PlantMaker = known_plant) -> list[Job]:
  """One per group of a setting whose trainings are there."""
  jobs = []
  for group in setting.groups:
    policies = trained(folder, group)
    if group == CONTROLLERS or policies:
      file = " ".join([group, *(label.split()[-1] for label in policies)]) + ".json"
      target = folder / "evaluated" / name.replace("/", " per ") / file
      work = partial(drive_group, group, policies, setting, target, plant)
      jobs.append(Job(f"drive {name} {group}", target, work))
  return jobs


def trained(folder: Path, variant: str) -> dict[str, Path]:
  """Policies of a variant's finished trainings, by label."""
  done = sorted((folder / variant).glob("seed*/result.json"))
  return {f"{variant} {file.parent.name.removeprefix('seed')}": file.parent / "best" for file in done}


def drive_group(group: str, policies: Mapping[str, Path], setting: Setting, file: Path, plant: PlantMaker) -> None:
  """Drive a group in all cases of a setting and keep the rows."""
  rows: list[Row] = []
  for case in setting.cases:
    members = contestants(policies, case.speed, baselines=group == CONTROLLERS)
    if group == CONTROLLERS:
      members = {label: c for label, c in members.items() if label.split()[1] in setting.versions}
    rows += run_together(members, case, plant)
  file.parent.mkdir(parents=True, exist_ok=True)
  for older in file.parent.glob(f"{group}*.json"):
    older.unlink()
  write_text(file, json.dumps([row.as_json() for row in rows]) + "\n")


def read_rows(file: Path) -> list[Row]:
  """What `drive_group` kept; errors of runs that left the path are infinite again."""
  rows = []
  for entry in json.loads(file.read_text(encoding="utf-8")):
    kept = entry["case"] | {"unknown": tuple(entry["case"].get("unknown", ()))}
    kept |= {"plant": RENAMED_PLANTS.get(kept["plant"], kept["plant"])}
    case = EvaluationCase(**{"known_from" if name == "told" else name: value for name, value in kept.items()})
    values = {f.name: entry[f.name] for f in dataclasses.fields(Kpis)}
    arrays = {n: np.array([np.inf if x is None else x for x in column]) for n, column in values.items()}
    rows.append(Row(entry["contestant"], case, Kpis(**arrays)))
  return rows
