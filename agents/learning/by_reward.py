"""Training by reward alone with an algorithm of stable-baselines3, on random tracks.

A folder of a training holds training.json (what was asked for), model.zip (SB3's own), best/ (the policy that did best
on tracks kept aside), evaluations.csv, tensorboard/, the last checkpoint and result.json. Test paths are never looked
at.
"""

import dataclasses
import json
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.control.closed_loop import Actuation, Scenario, drive
from agents.control.kpis import Kpis, kpis
from agents.control.model import Model
from agents.learning.checkpoint import POINTER
from agents.learning.critic import SeeingCriticPolicy, TruthBesides
from agents.learning.environments import (
  Options,
  OwnPlant,
  drawn_of,
  fleet,
  interface_of,
  model_of,
  plant_of,
  task_of,
)
from agents.learning.hyperparameters import ALGORITHMS, POLICY
from agents.learning.observation import OBSERVATIONS
from agents.learning.policy_file import Policy, export_onnx, load_policy, save_policy
from agents.learning.sb3_zip import policy_from
from agents.learning.train import EVALUATION_SEED, append_row, observer_of, rewrite
from agents.learning.trial import Trial
from agents.learning.trial_checkpoint import begin_anew, load_checkpoint, save_checkpoint
from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.envs.fleet_workers import WorkersVecEnv
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.extras import extra
from qcar_twin.untrusted import read_json

with extra("Training"):
  import torch
  from stable_baselines3.common.base_class import BaseAlgorithm
  from stable_baselines3.common.callbacks import BaseCallback, CallbackList
  from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
  from stable_baselines3.common.vec_env import VecNormalize

KEPT_ASIDE = ("random:900001", "random:900002")  # tracks by which the best policy is chosen
JUDGES = 16  # cars on each, with linkages of their own
LOST = 1e9  # written for an error of a car that left
COLUMNS = ("steps", "updates", "rmse", "me", "finished", "seconds", "cpu_seconds")


def judge(
  policy: Policy, options: Options, paths: Sequence[str], model: Model, own_plant: OwnPlant | None = None
) -> Kpis:
  """Indicators of a policy on paths one after another, JUDGES cars each, linkages and speeds over their ranges,
  parameters drawn where the options draw them."""
  make, theta = own_plant or plant_of(options, model)
  shares = np.random.default_rng(EVALUATION_SEED).uniform(-1.0, 1.0, (2, JUDGES))
  gathered = []
  for path in paths:
    task = task_of(dataclasses.replace(options, path=path, stretch=0.0), model.vehicle.max_steering)
    gain = task.steering_gain + shares[0] * task.gain_spread
    offset = task.steering_offset + shares[1] * task.offset_spread
    servo = Actuation(task.servo_delay, task.servo_lag, gain, offset)
    speed = task.speed + task.speed_spread * np.linspace(-1.0, 1.0, JUDGES)
    wanted = Scenario(task.path, speed, 1, task.lock, actuation=servo)
    plant, rng = make(), np.random.default_rng([EVALUATION_SEED, 1])
    observer = observer_of(options, model, JUDGES, plant.period)
    drawn = drawn_of(options, plant)
    parameters = np.stack([drawn.draw(plant, theta, rng) if drawn else theta for _ in range(JUDGES)])
    gathered.append(kpis(drive(plant, parameters, policy, model.speed_gains, observer, wanted)))
  names = [f.name for f in dataclasses.fields(Kpis)]
  return Kpis(**{name: np.concatenate([np.atleast_1d(getattr(k, name)) for k in gathered]) for name in names})


@dataclasses.dataclass
class Progress:
  """How far a training is: rows of evaluations.csv, the best so far, m, when the next evaluation is due, s spent, and
  how often it was resumed."""

  evaluations: list[list[float]] = dataclasses.field(default_factory=list)
  best: float = float("inf")
  best_steps: int = 0
  due: int = 0
  wall: float = 0.0
  cpu: float = 0.0
  evaluation: float = 0.0
  resumed: int = 0


class Judge(BaseCallback):
  """Evaluates on the tracks kept aside, keeps the best, writes checkpoints, ends in time."""

  def __init__(
    self, trial: Trial, folder: Path, model: Model, own_plant: OwnPlant | None, progress: Progress | None = None
  ):
    super().__init__()
    self._trial, self._folder, self._car, self._own_plant = trial, folder, model, own_plant
    self.progress = progress or Progress()
    before = self.progress
    self._clock, self._cpu = time.perf_counter() - before.wall, time.process_time() - before.cpu - before.evaluation

  @property
  def seconds(self) -> tuple[float, float]:
    """Since the start, of the clock and of the processor, without evaluations in the latter."""
    return time.perf_counter() - self._clock, time.process_time() - self._cpu - self.progress.evaluation

  def _on_step(self) -> bool:
    for info in self.locals["infos"]:
      if "episode" in info:
        self.logger.record_mean("episode/rmse", info["episode"]["rmse"])
        for name, value in info["reward_terms"].items():
          self.logger.record_mean(f"episode/{name}", value)
    return not (self._trial.seconds and self.seconds[1] > self._trial.seconds)

  def _on_rollout_start(self) -> None:
    if self._trial.every and self.num_timesteps >= self.progress.due and self.updates:
      self.progress.due = self.num_timesteps + self._trial.every
      self.look()
      self.progress.wall, self.progress.cpu = self.seconds
      save_checkpoint(self.model, self._folder, dataclasses.asdict(self.progress))
      begin_anew(self.model, self._trial.seed)

  @property
  def updates(self) -> int:
    return int(self.model._n_updates)  # type: ignore[attr-defined]

  def look(self) -> None:
    """Evaluate; keep the policy where it is the best so far."""
    begun = time.process_time()
    policy = policy_of(self.model, self._trial, self.result())
    judged = judge(policy, self._trial.options, KEPT_ASIDE, self._car, self._own_plant)
    rmse = float(np.mean(np.minimum(judged.rmse, 0.2)))
    self.progress.evaluation += time.process_time() - begun
    finished = float(np.mean(judged.finished))
    row = [self.num_timesteps, self.updates, rmse, float(np.max(judged.me)), finished, *self.seconds]
    self.progress.evaluations.append([value if np.isfinite(value) else LOST for value in row])
    append_row(self._folder / "evaluations.csv", COLUMNS, self.progress.evaluations[-1])
    self.logger.record("evaluation/rmse", rmse)
    if rmse < self.progress.best:
      self.progress.best, self.progress.best_steps = rmse, self.num_timesteps
      save_policy(policy, self._folder / "best")

  def result(self) -> dict[str, Any]:
    """How far it is."""
    wall, cpu = self.seconds
    seconds = {"total": round(wall, 2), "cpu": round(cpu, 2), "evaluation": round(self.progress.evaluation, 2)}
    return {"steps": int(self.num_timesteps), "updates": self.updates, "seconds": seconds}

  def _on_training_end(self) -> None:
    if self._trial.every:
      self.look()
    else:
      self.progress.best_steps = self.num_timesteps
      save_policy(policy_of(self.model, self._trial, self.result()), self._folder / "best")


def policy_of(agent: BaseAlgorithm, trial: Trial, result: dict[str, Any]) -> Policy:
  """The agent's actor as a policy."""
  tensors = {name: value.detach().cpu().clone() for name, value in agent.policy.state_dict().items()}
  kwargs = trial.hyperparameters.policy_kwargs
  data = {"policy_kwargs": {"activation_fn": kwargs["activation_fn"]} if "activation_fn" in kwargs else {}}
  policy = policy_from(tensors, data, trial.hyperparameters.algorithm)
  history = {"training": trial.as_json(), "result": result}
  return dataclasses.replace(policy, provenance=history, name=trial.hyperparameters.algorithm)


def cars_of(trial: Trial, model: Model, own_plant: OwnPlant | None, seeds: Sequence[int]) -> FleetVecEnv:
  """Cars of a training with these seeds, as its actor and its critic see them."""
  view = interface_of(trial.observation).view
  if trial.critic == "truth":
    view = TruthBesides(OBSERVATIONS[trial.observation])
  return FleetVecEnv(fleet(trial.options, seeds, model, own_plant), view, normalised=True)


def make_agent(
  trial: Trial, model: Model, own_plant: OwnPlant | None = None, device: str = "cpu", workers: int = 1
) -> BaseAlgorithm:
  """An untrained agent in its environment.

  Args:
    device: of torch's, for the networks.
    workers: processes that drive the cars; torch has as many threads, since one waits for the other.
  """
  torch.set_num_threads(workers)
  hyper = trial.hyperparameters
  seeds = [1_000_000 * (trial.seed + 1) + i for i in range(hyper.cars)]
  arguments, policy = hyper.arguments(), POLICY
  if trial.critic == "truth":
    policy = SeeingCriticPolicy
    arguments["policy_kwargs"] = {**arguments["policy_kwargs"], "seen": OBSERVATIONS[trial.observation].size}
  env: Any
  if workers > 1:
    shares = [part.tolist() for part in np.array_split(seeds, workers)]
    env = WorkersVecEnv([partial(cars_of, trial, model, own_plant, s) for s in shares], [len(s) for s in shares])
  else:
    env = cars_of(trial, model, own_plant, seeds)
  if hyper.normalise is not None:
    given: dict[str, Any] = dict(hyper.normalise)
    env = VecNormalize(env, gamma=float(hyper.rest.get("gamma", 0.99)), **given)
  return ALGORITHMS[hyper.algorithm](policy, env, seed=trial.seed, device=device, **arguments)


def train_by_reward(
  trial: Trial,
  folder: Path,
  callbacks: Sequence[BaseCallback] = (),
  model: Model | None = None,
  own_plant: OwnPlant | None = None,
  resume: bool = False,
  tensorboard: bool = True,
  device: str = "cpu",
  workers: int = 1,
) -> dict[str, Any]:
  """Train into a folder that holds no training yet, or go on with the one it holds.

  A resumed training ends in the weights of one that was never stopped: `trial_checkpoint` says how.

  Args:
    trial: what is asked for; of a training that is resumed, what its folder holds (`Trial.kept`).
    callbacks: of stable-baselines3, called besides the one that evaluates. What they remember is theirs to keep.
    resume: go on from the folder's last checkpoint.
    tensorboard: write curves.
    device: of torch's, for the networks.
    workers: processes that drive the cars.

  Returns:
    What result.json holds.

  Raises:
    FileExistsError: the folder holds a training and `resume` is off.
    FileNotFoundError: there is none to resume.
    ValueError: the training to resume is another one.
  """
  model = model or model_of(trial.options)
  if resume and (folder / "result.json").is_file() and _is_that_of(trial, folder):
    return read_json(folder / "result.json")
  again = resume and _is_that_of(trial, folder)
  resume = again and (folder / POINTER).is_file()
  agent, progress = make_agent(trial, model, own_plant, device, workers), Progress(due=trial.every)
  if resume:
    progress = Progress(**load_checkpoint(agent, folder))
    progress.resumed += 1
    begin_anew(agent, trial.seed)
  else:
    _begin(trial, folder, again)
  rewrite(folder / "evaluations.csv", COLUMNS, progress.evaluations)
  outputs: list[KVWriter] = [TensorBoardOutputFormat(str(folder / "tensorboard"))] if tensorboard else []
  agent.set_logger(Logger(None, outputs))
  referee = Judge(trial, folder, model, own_plant, progress)
  left = trial.hyperparameters.steps - agent.num_timesteps
  try:
    agent.learn(left, callback=CallbackList([referee, *callbacks]), reset_num_timesteps=False)
  finally:
    agent.get_env().close()  # type: ignore[union-attr]
  return _finish(agent, folder, referee)


def _finish(agent: BaseAlgorithm, folder: Path, referee: Judge) -> dict[str, Any]:
  """Writes what a training leaves; what result.json holds."""
  agent.save(folder / "model.zip")
  difference = export_onnx(load_policy(folder / "best"), folder / "best" / "policy.onnx")
  result = referee.result() | {
    "best_steps": referee.progress.best_steps,
    "best_rmse_kept_aside": referee.progress.best if referee.progress.evaluations else None,
    "onnx_difference": difference,
    "resumed": referee.progress.resumed,
  }
  write_json(folder / "result.json", result)
  return result


def _begin(trial: Trial, folder: Path, again: bool) -> None:
  """The folder of a training that begins; `again` where it was stopped before its first checkpoint."""
  asked = folder / "training.json"
  if asked.exists() and not again:
    raise FileExistsError(f"{folder} holds a training already; go on with --resume or choose another folder")
  folder.mkdir(parents=True, exist_ok=True)
  write_text(asked, json.dumps(trial.as_json(), indent=1) + "\n")


def _is_that_of(trial: Trial, folder: Path) -> bool:
  """True where the folder's training is this one. Raises ValueError for another, FileNotFoundError for none."""
  file = folder / "training.json"
  if not file.is_file():
    raise FileNotFoundError(f"{file}: no training to resume; start without --resume")
  if json.dumps(Trial.kept(file).as_json()) != json.dumps(trial.as_json()):
    raise ValueError(f"{folder} holds another training; resume it by its own plan, or choose another folder")
  return True
