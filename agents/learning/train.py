"""Training: episodes, logs, checkpoints, the best agent by evaluation on the training path.

A training folder holds training.json (what was asked for), episodes.csv and evaluations.csv, tensorboard/, the last
checkpoint, best/ and last/ (policies) and, once it is over, result.json. Test paths are never looked at here.
"""

import csv
import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.control.closed_loop import Actuation, Scenario, drive
from agents.control.kpis import Kpis, kpis
from agents.control.model import Model
from agents.learning.checkpoint import POINTER, load_checkpoint, save_checkpoint
from agents.learning.ddpg import Agent, Settings, actor_layers, demonstrate, make_agent
from agents.learning.environments import (
  Options,
  OwnPlant,
  fleet,
  model_of,
  plant_of,
  saved_options,
  settings_of,
  task_of,
)
from agents.learning.imitation import imitate, teacher
from agents.learning.observation import ObservationSpec
from agents.learning.policy_file import Policy, export_onnx, load_policy, observation_from, save_policy
from qcar_twin.atomic_io import naming, whole_file, write_json, write_text
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.estimation.observer import Observer, SensedObserver, TrueObserver
from qcar_twin.extras import extra
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors
from qcar_twin.untrusted import UnreadableFile, read_json

with extra("Training"):
  import torch
  from stable_baselines3.common.callbacks import BaseCallback
  from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat

EPISODE_COLUMNS = ("episode", "steps", "length", "return", "rmse", "finished", "seconds")
EVALUATION_COLUMNS = ("episode", "rmse", "me", "iaca", "finished", "seconds")
BENT = ((0.0, 0.0), (-0.5, 0.5), (0.5, -0.5), (0.0, 0.0))  # shares of the spreads of steering gain and offset
EVALUATION_SEED = 90_000  # sensor noise of evaluations during training: the same every time


@dataclasses.dataclass(frozen=True)
class Plan:
  """One training.

  Attributes:
    options: of the environment.  settings: of learning.  seed: of everything random.
    every: episodes between checkpoints, each with an evaluation on the training path.
    judges: cars of that evaluation, each with sensor noise of its own.
    progress_bar: shown on the terminal.
    observation: what the agent sees.
  """

  options: Options = Options()
  settings: Settings = Settings()
  seed: int = 0
  every: int = 15
  judges: int = 4
  progress_bar: bool = True
  observation: ObservationSpec = ObservationSpec()

  def as_json(self) -> dict[str, Any]:
    return dataclasses.asdict(self)

  @classmethod
  def from_json(cls, table: dict[str, Any]) -> "Plan":
    """A plan from what `as_json` gave."""
    options = saved_options(table["options"])
    settings = dict(table["settings"])
    settings["observation_scale"] = tuple(settings["observation_scale"])
    rest = {name: table[name] for name in ("seed", "every", "judges", "progress_bar")}
    seen = observation_from(table.get("observation", table.get("sight", {})))  # the word of earlier versions
    return cls(options, Settings(**settings), **rest, observation=seen)

  @classmethod
  def kept(cls, file: Path) -> "Plan":
    """The plan in a training's folder. Raises UnreadableFile where it is none."""
    try:
      return cls.from_json(read_json(file))
    except (KeyError, TypeError, ValueError) as error:
      raise UnreadableFile(f"{file}: is no plan of a training ({error}); start in another folder") from error


@dataclasses.dataclass
class Progress:
  """How far a training is: rows of both tables, the best so far, s spent, and how often it was resumed."""

  episodes: list[list[float]] = dataclasses.field(default_factory=list)
  evaluations: list[list[float]] = dataclasses.field(default_factory=list)
  best: float = 1e9  # m
  best_episode: int = 0
  seconds: dict[str, float] = dataclasses.field(
    default_factory=lambda: {"total": 0.0, "cpu": 0.0, "learning": 0.0, "evaluation": 0.0}
  )
  resumed: int = 0


def policy_of(agent: Agent, plan: Plan, provenance: dict[str, Any]) -> Policy:
  """The agent's actor as a policy."""
  task = task_of(plan.options)
  layers, scale = tuple(actor_layers(agent)), (*plan.settings.observation_scale, *plan.observation.scale)
  kind = plan.settings.algorithm if plan.settings.episodes else "imitation"
  return Policy(layers, scale, task.largest_rate, task.lock, provenance, kind, plan.observation)


def judge(policy: Policy, plan: Plan, model: Model, own_plant: OwnPlant | None = None) -> Kpis:
  """Indicators of a policy on the path it is trained on, from the path's start, in the plant it is trained in.

  Where training draws the linkage, the cars have linkages spread over half of its range.
  """
  options, task = plan.options, task_of(plan.options, model.vehicle.max_steering)
  make, theta = own_plant or plant_of(options, model)
  plant = make()
  observer = observer_of(options, model, plan.judges, plant.period)
  bent = np.resize(BENT, (plan.judges, 2)) * (task.gain_spread, task.offset_spread)
  gain, offset = bent.T + np.array([[task.steering_gain], [task.steering_offset]])
  servo = Actuation(task.servo_delay, task.servo_lag, gain, offset)
  wanted = Scenario(task.path, task.speed, task.laps, task.lock, actuation=servo)
  gains = model.speed_gains
  return kpis(drive(plant, np.tile(theta, (plan.judges, 1)), policy, gains, observer, wanted))


def observer_of(options: Options, model: Model, count: int, period: float) -> Observer:
  """What cars of an evaluation, with control periods of so many s, know of themselves; the same noise every time."""
  if options.estimator != "fekf":
    return TrueObserver()
  suite = SensorSuite(qcar_sensors(), count, EVALUATION_SEED, period)
  return SensedObserver(suite, model.car, dataclasses.replace(settings_of(options, model), period=period))


class Keeper(BaseCallback):
  """Counts episodes, writes the tables, evaluates, keeps the best, saves checkpoints, stops in time."""

  def __init__(self, plan: Plan, folder: Path, model: Model, progress: Progress, own_plant: OwnPlant | None):
    super().__init__()
    self._plan, self._folder, self._model, self._own_plant = plan, folder, model, own_plant
    self.progress = progress
    self._due = False
    self._clock = time.perf_counter()
    self._cpu_clock = time.process_time()
    self._before, self._cpu_before = progress.seconds["total"], progress.seconds["cpu"]
    self._bar = tqdm(
      total=plan.settings.episodes,
      initial=len(progress.episodes),
      unit="episode",
      disable=not (plan.progress_bar and sys.stderr.isatty()),
    )

  @property
  def agent(self) -> Agent:
    return self.model  # type: ignore[return-value]

  def _on_step(self) -> bool:
    total = self._plan.settings.episodes
    for info in self.locals["infos"]:
      if "episode" in info and len(self.progress.episodes) < total:
        self._count(info["episode"])
    return len(self.progress.episodes) < total

  def _count(self, episode: dict[str, Any]) -> None:
    number = len(self.progress.episodes) + 1
    row = [number, self.num_timesteps, episode["l"], episode["r"], episode["rmse"], float(episode["finished"])]
    row.append(self._elapsed())
    self.progress.episodes.append(row)
    append_row(self._folder / "episodes.csv", EPISODE_COLUMNS, row)
    for name in ("r", "l", "rmse"):
      self.logger.record_mean(f"episode/{name}", episode[name])
    self.agent.advance(number / self._plan.settings.episodes)
    self._due |= number % self._plan.every == 0
    self._bar.update()

  def _on_rollout_end(self) -> None:
    if self._due:
      self._due = False
      self.keep()

  def keep(self) -> None:
    """Evaluate if the car stays on the path by now, or has just imitated, then save a checkpoint."""
    recent = self.progress.episodes[-self._plan.every :]
    if not recent or any(row[5] for row in recent):
      self._evaluate()
    self.progress.seconds["total"] = self._elapsed()
    self.progress.seconds["cpu"] = self._cpu_before + time.process_time() - self._cpu_clock
    self.progress.seconds["learning"] = self.agent.learning_seconds
    save_checkpoint(self.agent, self._folder, dataclasses.asdict(self.progress))

  def _evaluate(self) -> None:
    begun = time.perf_counter()
    episode = len(self.progress.episodes)
    policy = policy_of(self.agent, self._plan, provenance(self._plan, episode))
    judged = judge(policy, self._plan, self._model, self._own_plant)
    rmse = float(np.mean(np.minimum(judged.rmse, 0.2)))
    row = [episode, rmse, float(np.max(judged.me)), float(np.mean(judged.iaca)), float(np.mean(judged.finished))]
    self.progress.seconds["evaluation"] += time.perf_counter() - begun
    row.append(self._elapsed())
    self.progress.evaluations.append(row)
    append_row(self._folder / "evaluations.csv", EVALUATION_COLUMNS, row)
    self.logger.record("evaluation/rmse", rmse)
    self._say(episode, f"S-path {1e3 * rmse:.1f} mm" if self._plan.options.path == "s" else f"{1e3 * rmse:.1f} mm")
    if rmse < self.progress.best:
      self.progress.best, self.progress.best_episode = rmse, episode
      save_policy(policy, self._folder / "best")

  def _say(self, episode: int, error: str) -> None:
    """The last evaluation, behind the bar; one plain line where the output is no terminal."""
    self._bar.set_postfix_str(error)
    if self._plan.progress_bar and not sys.stderr.isatty():
      total = self._plan.settings.episodes
      left = self._elapsed() / max(episode, 1) * (total - episode) / 60.0
      print(f"episode {episode} of {total} · {error} · about {left:.0f} min left", file=sys.stderr, flush=True)

  def _on_training_end(self) -> None:
    self.keep()
    self._bar.close()

  def _elapsed(self) -> float:
    return self._before + time.perf_counter() - self._clock


def append_row(file: Path, columns: tuple[str, ...], row: list[float]) -> None:
  """One row at the end of a table, which is begun where there is none."""
  fresh = not file.exists()
  with naming(file.parent), open(file, "a", newline="", encoding="utf-8") as stream:
    writer = csv.writer(stream)
    if fresh:
      writer.writerow(columns)
    writer.writerow([f"{value:.6g}" for value in row])


def rewrite(file: Path, columns: tuple[str, ...], rows: list[list[float]]) -> None:
  """A table of exactly these rows: what came after the last checkpoint is driven again."""
  with whole_file(file) as part, open(part, "w", newline="", encoding="utf-8") as stream:
    writer = csv.writer(stream)
    writer.writerow(columns)
    writer.writerows([[f"{value:.6g}" for value in row] for row in rows])


def provenance(plan: Plan, episode: int) -> dict[str, Any]:
  """Where a policy comes from."""
  return {"training": plan.as_json(), "episode": episode}


def train(
  plan: Plan, folder: Path, resume: bool = False, model: Model | None = None, own_plant: OwnPlant | None = None
) -> dict[str, Any]:
  """Train an agent into a folder; with `resume`, from its last checkpoint and by its own plan.

  Returns:
    What result.json holds.

  Raises:
    FileExistsError: the folder holds a training and `resume` is off.
    FileNotFoundError: nothing to resume.
  """
  asked = folder / "training.json"
  if resume and asked.is_file():
    plan = Plan.kept(asked)
    resume = (folder / POINTER).is_file()  # one that was killed before its first checkpoint begins again
  elif asked.is_file():
    raise FileExistsError(f"{folder} holds a training already; go on with --resume or choose another folder")
  folder.mkdir(parents=True, exist_ok=True)
  model = model or model_of(plan.options)
  torch.set_num_threads(1)
  seen = plan.observation if plan.observation != ObservationSpec() else None
  env = FleetVecEnv(fleet(plan.options, _seeds(plan, 0), model, own_plant), seen)
  agent = make_agent(env, plan.settings, plan.seed, plan.observation.scale)
  progress = Progress()
  if resume:
    progress = Progress(**load_checkpoint(agent, folder))
    progress.resumed += 1
    agent.learning_seconds = progress.seconds["learning"]
    env.fleet.seed(_seeds(plan, progress.resumed))
  rewrite(folder / "episodes.csv", EPISODE_COLUMNS, progress.episodes)
  rewrite(folder / "evaluations.csv", EVALUATION_COLUMNS, progress.evaluations)
  if not resume:
    write_text(asked, json.dumps(plan.as_json(), indent=1) + "\n")
    if plan.settings.demonstrations:
      demonstrate(agent, plan.settings.demonstrations)
  agent.set_logger(Logger(None, [TensorBoardOutputFormat(str(folder / "tensorboard"))]))
  keeper = Keeper(plan, folder, model, progress, own_plant)
  if plan.settings.imitations and not resume:
    law = teacher(model, plan.options.speed, plan.options.twin)
    imitate(agent, law, plan.settings.imitations, plan.seed)
    keeper.init_callback(agent)
    keeper.keep()
  if len(progress.episodes) < plan.settings.episodes:
    agent.learn(10**9, callback=keeper, log_interval=10, reset_num_timesteps=False)
  return _finish(agent, plan, folder, progress)


def _seeds(plan: Plan, resumed: int) -> list[int]:
  """One per car, different for every training and every time it is resumed."""
  return [1_000_000 * (plan.seed + 1) + 1000 * resumed + i for i in range(plan.settings.cars)]


def _finish(agent: Agent, plan: Plan, folder: Path, progress: Progress) -> dict[str, Any]:
  last = policy_of(agent, plan, provenance(plan, len(progress.episodes)))
  save_policy(last, folder / "last")
  if not (folder / "best" / "policy.json").exists():
    save_policy(last, folder / "best")
  difference = export_onnx(load_policy(folder / "best"), folder / "best" / "policy.onnx")
  finished = [row[5] for row in progress.episodes]
  run = np.convolve(finished or [0.0], np.ones(10), "valid") >= 10.0
  result = {
    "episodes": len(progress.episodes),
    "steps": agent.num_timesteps,
    "updates": agent._n_updates,
    "seconds": {name: round(value, 2) for name, value in progress.seconds.items()},
    "best_episode": progress.best_episode,
    "best_rmse_training_path": progress.best if progress.evaluations else None,
    "ten_full_episodes_in_a_row_at": int(np.argmax(run)) + 10 if run.any() else None,
    "onnx_difference": difference,
    "resumed": progress.resumed,
  }
  write_json(folder / "result.json", result)
  return result
