"""Training by reward alone with an algorithm of stable-baselines3, on random tracks.

A folder of a training holds training.json (what was asked for), model.zip (SB3's own), best/ (the policy that did best
on tracks kept aside), evaluations.csv, tensorboard/ and result.json. Test paths are never looked at.
"""

import dataclasses
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.control.closed_loop import Actuation, Task, drive
from agents.control.kpis import Kpis, kpis
from agents.control.model import Model
from agents.control.speed import SpeedGains
from agents.learning.environments import Options, OwnPlant, fleet, interface_of, plant_of, task_of
from agents.learning.hyperparameters import ALGORITHMS, Hyperparameters, read_hyperparameters
from agents.learning.policy_file import Policy, export_onnx, load_policy, save_policy
from agents.learning.sb3_zip import policy_from
from agents.learning.train import append_row
from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.envs.task import Reward
from qcar_twin.envs.vector_env import FleetVecEnv
from qcar_twin.estimation.observer import SensedObserver, TrueObserver
from qcar_twin.extras import extra
from qcar_twin.sensors.suite import SensorSuite, qcar_sensors
from qcar_twin.tracks import path_from

with extra("Training"):
  import torch
  from stable_baselines3.common.base_class import BaseAlgorithm
  from stable_baselines3.common.callbacks import BaseCallback, CallbackList
  from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat
  from stable_baselines3.common.vec_env import VecNormalize

KEPT_ASIDE = ("random:900001", "random:900002")  # tracks by which the best policy is chosen
JUDGES = 16  # cars on each, with linkages of their own
EVALUATION_SEED = 90_000
COLUMNS = ("steps", "updates", "rmse", "me", "finished", "seconds", "cpu_seconds")
TRACKS = Options(
  path="random:1:400",
  stretch=6.0,
  plant="reduced",
  demonstrator="",
  gain_spread=0.1,
  offset_spread=1.5,
  reward=Reward(m3=0.0, m4=0.0, m5=0.01, m6=0.0, near=0.001),
)
"""The default task: 400 m of random track on the reduced car, 6 m an episode, a linkage of its own in each."""


@dataclasses.dataclass(frozen=True)
class Trial:
  """One training by reward.

  Attributes:
    hyperparameters: of the algorithm.  options: of the environment.
    observation: what is seen, a key of `SIGHTS`.  seed: of everything random.
    every: environment steps between evaluations.
    seconds: of the processor after which it ends; 0 for none.
  """

  hyperparameters: Hyperparameters
  options: Options = TRACKS
  observation: str = "wide"
  seed: int = 0
  every: int = 500_000
  seconds: float = 0.0

  def as_json(self) -> dict[str, Any]:
    return dataclasses.asdict(self)


def trial_from(asked: Mapping[str, Any]) -> Trial:
  """The training that options of `qcar-twin train`, by name, ask for: random tracks on the reduced car by default."""
  quick, path = asked["quick"], asked["path"]
  options = dataclasses.replace(TRACKS, twin=asked["twin"], estimator="truth" if quick else asked["estimator"])
  if path:
    options = dataclasses.replace(options, path=path, stretch=TRACKS.stretch if path.startswith("random:") else 0.0)
    options = dataclasses.replace(options, stretch=min(options.stretch, path_from(path).length))
  gathered = read_hyperparameters(asked["algorithm"], asked["hyperparameters"])
  return Trial(quickly(gathered) if quick else gathered, options, asked["observation"], asked["seed"])


def in_words(result: Mapping[str, Any]) -> str:
  """What came of it, in a line."""
  seconds, best = result["seconds"]["cpu"], 1e3 * result["best_rmse_kept_aside"]
  return f"{result['updates']} updates in {seconds:.0f} s of CPU, best {best:.1f} mm RMSE on tracks kept aside"


def quickly(hyper: Hyperparameters) -> Hyperparameters:
  """A few thousand steps, to test that everything runs."""
  cars = min(hyper.cars, 16)
  if "learning_starts" in hyper.rest:
    steps, small = 40 * cars, {"learning_starts": 64, "buffer_size": 10_000}
  else:
    steps, small = 2 * 64 * cars, {"n_steps": 64, "batch_size": 64 * cars}
  return dataclasses.replace(hyper, steps=steps, cars=cars, rest=hyper.rest | small)


def judge(
  policy: Policy, options: Options, paths: Sequence[str], model: Model, own_plant: OwnPlant | None = None
) -> Kpis:
  """Indicators of a policy on paths one after another, JUDGES cars each, linkages spread evenly over their range."""
  make, theta = own_plant or plant_of(options, model)
  shares = np.random.default_rng(EVALUATION_SEED).uniform(-1.0, 1.0, (2, JUDGES))
  gathered = []
  for path in paths:
    task = task_of(dataclasses.replace(options, path=path, stretch=0.0), model.vehicle.max_steering)
    gain = task.steering_gain + shares[0] * task.gain_spread
    offset = task.steering_offset + shares[1] * task.offset_spread
    observer = TrueObserver()
    if options.estimator == "fekf":
      suite = SensorSuite(qcar_sensors(), JUDGES, EVALUATION_SEED)
      observer = SensedObserver(suite, model.car, model.filter_settings(options.plant))
    servo = Actuation(task.servo_delay, task.servo_lag, gain, offset)
    wanted = Task(task.path, task.speed, 1, task.lock, actuation=servo)
    parameters = np.tile(theta, (JUDGES, 1))
    gathered.append(kpis(drive(make(), parameters, policy, SpeedGains.design(model.car), observer, wanted)))
  names = [f.name for f in dataclasses.fields(Kpis)]
  return Kpis(**{name: np.concatenate([np.atleast_1d(getattr(k, name)) for k in gathered]) for name in names})


class Judge(BaseCallback):
  """Evaluates on the tracks kept aside, keeps the best, ends in time."""

  def __init__(self, trial: Trial, folder: Path, model: Model, own_plant: OwnPlant | None):
    super().__init__()
    self._trial, self._folder, self._car, self._own_plant = trial, folder, model, own_plant
    self._next, self.best, self.best_steps = 0, float("inf"), 0
    self.evaluation = 0.0  # s of the processor
    self._clock, self._cpu = time.perf_counter(), time.process_time()

  @property
  def seconds(self) -> tuple[float, float]:
    """Since the start, of the clock and of the processor, without evaluations in the latter."""
    return time.perf_counter() - self._clock, time.process_time() - self._cpu - self.evaluation

  def _on_step(self) -> bool:
    for info in self.locals["infos"]:
      if "episode" in info:
        self.logger.record_mean("episode/rmse", info["episode"]["rmse"])
        for name, value in info["reward_terms"].items():
          self.logger.record_mean(f"episode/{name}", value)
    return not (self._trial.seconds and self.seconds[1] > self._trial.seconds)

  def _on_rollout_start(self) -> None:
    if self.num_timesteps >= self._next and self.updates:
      self._next = self.num_timesteps + self._trial.every
      self.look()

  @property
  def updates(self) -> int:
    return int(self.model._n_updates)  # type: ignore[attr-defined]

  def look(self) -> None:
    """Evaluate; keep the policy where it is the best so far."""
    begun = time.process_time()
    policy = policy_of(self.model, self._trial, self.result())
    judged = judge(policy, self._trial.options, KEPT_ASIDE, self._car, self._own_plant)
    rmse = float(np.mean(np.minimum(judged.rmse, 0.2)))
    self.evaluation += time.process_time() - begun
    finished = float(np.mean(judged.finished))
    row = [self.num_timesteps, self.updates, rmse, float(np.max(judged.me)), finished, *self.seconds]
    append_row(self._folder / "evaluations.csv", COLUMNS, row)
    self.logger.record("evaluation/rmse", rmse)
    if rmse < self.best:
      self.best, self.best_steps = rmse, self.num_timesteps
      save_policy(policy, self._folder / "best")

  def result(self) -> dict[str, Any]:
    """How far it is."""
    wall, cpu = self.seconds
    seconds = {"total": round(wall, 2), "cpu": round(cpu, 2), "evaluation": round(self.evaluation, 2)}
    return {"steps": int(self.num_timesteps), "updates": self.updates, "seconds": seconds}

  def _on_training_end(self) -> None:
    self.look()


def policy_of(agent: BaseAlgorithm, trial: Trial, result: dict[str, Any]) -> Policy:
  """The agent's actor as a policy."""
  tensors = {name: value.detach().clone() for name, value in agent.policy.state_dict().items()}
  kwargs = trial.hyperparameters.policy_kwargs
  data = {"policy_kwargs": {"activation_fn": kwargs["activation_fn"]} if "activation_fn" in kwargs else {}}
  policy = policy_from(tensors, data, trial.hyperparameters.algorithm)
  history = {"training": trial.as_json(), "result": result}
  return dataclasses.replace(policy, provenance=history, name=trial.hyperparameters.algorithm)


def make_agent(trial: Trial, model: Model, own_plant: OwnPlant | None = None) -> BaseAlgorithm:
  """An untrained agent in its environment; torch is held to one thread, on which networks this small are faster."""
  torch.set_num_threads(1)
  hyper = trial.hyperparameters
  seeds = [1_000_000 * (trial.seed + 1) + i for i in range(hyper.cars)]
  view = interface_of(trial.observation).view
  env: Any = FleetVecEnv(fleet(trial.options, seeds, model, own_plant), view, normalised=True)
  if hyper.normalise is not None:
    given: dict[str, Any] = dict(hyper.normalise)
    env = VecNormalize(env, gamma=float(hyper.rest.get("gamma", 0.99)), **given)
  return ALGORITHMS[hyper.algorithm](hyper.policy, env, seed=trial.seed, device="cpu", **hyper.arguments())


def train_by_reward(
  trial: Trial,
  folder: Path,
  callbacks: Sequence[BaseCallback] = (),
  model: Model | None = None,
  own_plant: OwnPlant | None = None,
) -> dict[str, Any]:
  """Train into a folder that holds no training yet.

  Args:
    callbacks: of stable-baselines3, called besides the one that evaluates.

  Returns:
    What result.json holds.

  Raises:
    FileExistsError: the folder holds a training.
  """
  if (folder / "training.json").exists():
    raise FileExistsError(f"{folder} holds a training already; choose another folder")
  folder.mkdir(parents=True, exist_ok=True)
  write_text(folder / "training.json", json.dumps(trial.as_json(), indent=1) + "\n")
  model = model or Model.nominal()
  agent = make_agent(trial, model, own_plant)
  agent.set_logger(Logger(None, [TensorBoardOutputFormat(str(folder / "tensorboard"))]))
  referee = Judge(trial, folder, model, own_plant)
  agent.learn(trial.hyperparameters.steps, callback=CallbackList([referee, *callbacks]))
  agent.save(folder / "model.zip")
  difference = export_onnx(load_policy(folder / "best"), folder / "best" / "policy.onnx")
  result = referee.result() | {
    "best_steps": referee.best_steps,
    "best_rmse_kept_aside": referee.best,
    "onnx_difference": difference,
  }
  write_json(folder / "result.json", result)
  return result
