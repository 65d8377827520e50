"""The path-tracking task wired up: plant, sensors and filter, speed control and demonstrator by name.

Importing this module registers `QcarTwin/PathTracking-v1` with gymnasium, as
`gymnasium.make("agents.learning.environments:QcarTwin/PathTracking-v1")` does (gymnasium from 1.0 on reads no entry
points of packages). Every field of `Options` is an argument. `-v0` is the same with four errors and rates in SI units.
"""

import dataclasses
import difflib
import secrets
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from agents.control import controllers
from agents.control.model import Model, known_of_twin
from agents.control.speed import SpeedController
from agents.learning.demonstrator import expert
from agents.learning.observation import OBSERVATIONS
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.cures import RENAMED_PLANTS
from qcar_twin.envs.fleet import Demonstrator, Drawn, Fleet, FleetConfig, Spread
from qcar_twin.envs.gym_env import FleetVectorEnv, PathTrackingEnv
from qcar_twin.envs.spaces import Interface
from qcar_twin.envs.task import NEVER_NEGATIVE, POSITIVE, Reward, TrackingTask, refuse_numbers
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.extras import extra
from qcar_twin.parameters import Parameter, ParameterSet
from qcar_twin.plant import Plant
from qcar_twin.sensors.suite import qcar_sensors
from qcar_twin.tracks import path_from
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.posterior import believed_twin, load_posterior
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR

with extra("The gymnasium environment"):
  import gymnasium

Array = NDArray[np.float64]
PlantName = Literal["mujoco", "reduced", "bicycle"]
ENV_ID, SI_ENV_ID = "QcarTwin/PathTracking-v1", "QcarTwin/PathTracking-v0"
SERVO = (0.02, 0.04)  # s, delay and lag of the servo for a plant that has none


@dataclasses.dataclass(frozen=True)
class Options:
  """What an environment is made of.

  Attributes:
    path: s, o, infinity, c, random:SEED, random:SEED:LENGTH, or FILE.csv.  speed: m/s.  laps: of a closed path.
    stretch: episodes begin anywhere on the path and end after so many m; 0: from its start to its end.
    plant: "mujoco", "reduced" or "bicycle"; `own_plant` of `fleet` takes any other.
    twin: twin file of a calibrated or repaired twin; the nominal twin without it.
    substeps: simulation steps of the twin per control period; 2 is meant for training, 5 for everything else.
    estimator: what the agent sees: the federated filter on noisy sensors, or the truth.
    unknown: numbers that the filter estimates besides the motion, of `PRIORS`; none for the plain filter.
    demonstrator, version: controller of agents/data/controllers.toml whose steering angle the reward compares with;
      "" for none.
    steering_gain, steering_offset: of the linkage, - and deg; neither agent nor filter knows them.
    gain_spread, offset_spread: half-widths around them, - and deg, within which every episode's linkage is drawn.
    speed_spread: half-width around the speed, m/s, within which every episode's is drawn.
    randomise: what is drawn of the twin for every episode: nothing, its measured parameters within their standard
      deviations ("prior"), or a model with its parameters as a diagnosis believes in it ("posterior").
    diagnosis: folder of that diagnosis, whose twin is driven.
    informed: the filter is told what the twin file, or the diagnosis's twin.toml, says of steering and delays; not of
      sensors, whose errors the simulated ones do not have.
    start_offset, start_heading: episodes start within +- these, m and rad.
    reward: weights.

  Raises:
    ValueError: a choice there isn't, with the nearest one, or a number that cannot be.
    TypeError: no number where one belongs.
  """

  path: str = "s"
  speed: float = 0.5
  laps: int = 1
  plant: PlantName = "mujoco"
  twin: str = ""
  substeps: int = 2
  estimator: Literal["fekf", "truth"] = "fekf"
  demonstrator: str = "lq_ed"
  version: str = "loose"
  steering_gain: float = 1.0
  steering_offset: float = 0.0
  gain_spread: float = 0.0
  offset_spread: float = 0.0
  randomise: Literal["none", "prior", "posterior"] = "none"
  start_offset: float = 0.05
  start_heading: float = 0.1
  reward: Reward = Reward()
  stretch: float = 0.0
  speed_spread: float = 0.0
  unknown: tuple[str, ...] = ()
  diagnosis: str = ""
  informed: bool = False

  def __post_init__(self) -> None:
    refuse_numbers(self, (*POSITIVE, "substeps"), NEVER_NEGATIVE)
    for name, hint in get_type_hints(type(self)).items():
      if get_origin(hint) is Literal:
        one_of_them(name, getattr(self, name), get_args(hint))
    FilterSettings().estimating(*self.unknown)
    if not isinstance(self.reward, Reward):
      raise TypeError(f"reward must be a Reward, or a table of its weights, not {self.reward!r:.60}")
    if not self.steering_gain > 0.0:
      raise ValueError(f"steering_gain {self.steering_gain:g}: a linkage's gain is more than 0, and 1 of a sound one")
    lock = float(np.degrees(QCAR.max_steering))  # more than the lock leaves no steering to one side
    for name, most, unit in (("steering_offset", lock, "deg"), ("start_heading", 0.5 * np.pi, "rad")):
      if abs(getattr(self, name)) >= most:
        raise ValueError(f"{name} {getattr(self, name):g} {unit}: a car can follow no path with {most:.3g} or more")
    if self.start_offset >= TrackingTask.lost:
      raise ValueError(f"start_offset {self.start_offset:g} m: a car is lost from {TrackingTask.lost:g} m on")
    if self.plant == "bicycle" and self.randomise != "none":
      raise ValueError("randomise draws the parameters of a twin, and the bicycle has none of them: plant='reduced'")
    if (self.randomise == "posterior") != bool(self.diagnosis) or (self.diagnosis and self.twin):
      raise ValueError(
        "randomise posterior and the diagnosis's folder go together, without a twin file; for the diagnosis's twin"
        " alone, twin = its twin.toml"
      )
    if self.informed and not self.known_from:
      raise ValueError("an informed filter needs what informs it: a twin file, or a diagnosis")
    if self.version not in controllers.VERSIONS:
      one_of_them("version", self.version, controllers.VERSIONS)
    if self.demonstrator:
      one_of_them("demonstrator", self.demonstrator, tuple(controllers.FAMILIES))

  @property
  def known_from(self) -> str:
    """Twin file that an informed filter is told by; "" for none."""
    return self.twin or (str(Path(self.diagnosis) / "twin.toml") if self.diagnosis else "")


def one_of_them(name: str, value: object, choices: Sequence[str]) -> None:
  """Raises ValueError where a value is none of the choices; the message names the nearest one."""
  if value not in choices:
    renamed = RENAMED_PLANTS.get(str(value)) if name == "plant" else None
    near = [renamed] if renamed else difflib.get_close_matches(str(value), choices, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise ValueError(f"no {name} '{value}': {hint}there are {', '.join(choices)}")


OwnPlant = tuple[Callable[[], Plant], Array]
"""Makes a plant, and its parameters (P,)."""


def task_of(options: Options, lock: float = QCAR.max_steering) -> TrackingTask:
  """The task; a lock of the steering in rad."""
  delay, lag = SERVO if options.plant == "bicycle" else (0.0, 0.0)
  return TrackingTask(
    path_from(options.path, options.laps),
    options.speed,
    options.laps,
    options.reward,
    lock=lock,
    stretch=options.stretch,
    start_offset=options.start_offset,
    start_heading=options.start_heading,
    steering_gain=options.steering_gain,
    steering_offset=float(np.radians(options.steering_offset)),
    gain_spread=options.gain_spread,
    offset_spread=float(np.radians(options.offset_spread)),
    servo_delay=delay,
    servo_lag=lag,
    speed_spread=options.speed_spread,
  )


def model_of(options: Options) -> Model:
  """The identified model of filter, speed control and demonstrator: of the twin that the options name, else the QCar's
  nominal one."""
  if options.twin or options.diagnosis:
    load, place = (believed_twin, options.diagnosis) if options.diagnosis else (load_twin, options.twin)
    return Model.of_twin(*load(place, options.substeps, 1))
  return Model.nominal()


def plant_of(options: Options, model: Model) -> OwnPlant:
  """The plant that the options name."""
  if options.plant == "bicycle":
    return partial(Bicycle, model.vehicle), model.theta
  if options.twin or options.diagnosis:
    load, place = (believed_twin, options.diagnosis) if options.diagnosis else (load_twin, options.twin)
    theta = load(place, options.substeps, 1)[1]
    return partial(_from_file, load, place, options.substeps, options.plant), theta
  make = partial(Twin, model.vehicle, substeps=options.substeps, threads=1, engine=options.plant)
  return make, make().parameters.nominal


def _from_file(load: Callable[..., tuple[Twin, Array]], place: str, substeps: int, engine: EngineKind) -> Twin:
  return load(place, substeps, 1)[0].on(engine)


def settings_of(options: Options, model: Model) -> FilterSettings:
  """Settings of the filter that the options ask for."""
  settings = model.filter_settings(options.plant)
  if options.informed:
    settings = settings.with_known(known_of_twin(options.known_from))
  return settings.estimating(*options.unknown)


def demonstrator_of(options: Options, model: Model) -> Demonstrator | None:
  """The controller whose steering angle the reward compares with; None where the options name none."""
  if not options.demonstrator:
    return None
  return expert(options.demonstrator, options.version, path_from(options.path), options.speed, model)


def prior_spread(plant: Plant) -> Spread:
  """The parameters with a prior, within their standard deviations, independent of each other."""
  known = [p for p in plant.parameters if p.kind != "open"]
  return Spread(tuple(p.name for p in known), np.diag([_drawn(p) ** 2 for p in known]))


def _drawn(parameter: Parameter) -> float:
  """Standard deviation of a draw: of what only the class says a log-normal prior's, but no more than a typical size."""
  return parameter.std or min(float(ParameterSet([parameter]).std[0]), parameter.scale)


def drawn_of(options: Options, plant: Plant) -> Drawn | None:
  """What the options have drawn of a plant for every episode; None for nothing."""
  if options.randomise == "none":
    return None
  return load_posterior(options.diagnosis) if options.diagnosis else prior_spread(plant)


def fleet(
  options: Options,
  seeds: Sequence[int],
  model: Model | None = None,
  own_plant: OwnPlant | None = None,
  spread: Drawn | None = None,
) -> Fleet:
  """N cars, one per seed.

  Args:
    model: the identified model of filter, speed control and demonstrator; without it, that of the options' twin.
    own_plant: instead of the one the options name; it must have a servo of its own.
    spread: of the plant's parameters over episodes, for instance a calibration's covariance.

  Raises:
    ValueError: the options ask for a speed that the identified car does not reach.
  """
  model = model or model_of(options)
  make, theta = own_plant or plant_of(options, model)
  spread = spread or drawn_of(options, make())
  sensed, gains = options.estimator == "fekf", model.speed_gains
  gains.require(options.speed + options.speed_spread)
  config = FleetConfig(
    plant=make,
    theta=theta,
    speed_control=partial(SpeedController, gains),
    demonstrator=demonstrator_of(options, model),
    sensors=qcar_sensors() if sensed else None,
    car=model.car,
    settings=settings_of(options, model) if sensed else None,
    spread=spread,
  )
  return Fleet(task_of(options, model.vehicle.max_steering), config, seeds)


MAKE = ("observation", "normalised", "render_mode", "seed")  # of `make_env`, besides


def interface_of(observation: str = "wide", normalised: bool = True) -> Interface:
  """What an agent sees, by its name in `OBSERVATIONS`, and in which units."""
  one_of_them("observation", observation, tuple(OBSERVATIONS))
  if not isinstance(normalised, bool):
    raise TypeError(f"normalised must be True or False, not {normalised!r:.60}")
  return Interface(OBSERVATIONS[observation] if observation != "errors" else None, normalised)


def options_from(given: Mapping[str, Any]) -> Options:
  """Options from keyword arguments; the reward may be a table of its weights, unknown numbers a list or one name.

  What is drawn may be yes, for "prior", or no.

  Raises:
    TypeError: a name there isn't, with the nearest one.
  """
  _names_of(Options, given, "option")
  reward = given.get("reward", Options.reward)
  if isinstance(reward, Mapping):
    _names_of(Reward, reward, "weight of the reward")
    reward = Reward(**reward)
  unknown = given.get("unknown", ())
  unknown = (unknown,) if isinstance(unknown, str) else tuple(unknown)
  randomise = given.get("randomise", "none")
  randomise = {True: "prior", False: "none"}.get(randomise, randomise)
  return Options(**{**given, "reward": reward, "unknown": unknown, "randomise": randomise})


def saved_options(table: Mapping[str, Any]) -> Options:
  """Options of a file, which may name the plant by the word of an earlier version."""
  plant = table.get("plant", Options.plant)
  return options_from({**table, "plant": RENAMED_PLANTS.get(plant, plant)})


def _names_of(kind: type, given: Mapping[str, Any], what: str) -> None:
  """Raises TypeError where a key is no field of a data class, with the nearest one."""
  known = [*(f.name for f in dataclasses.fields(kind)), *(MAKE if kind is Options else ())]
  for name in given:
    if name not in known:
      near = difflib.get_close_matches(name, known, n=1)
      raise TypeError(
        f"no {what} '{name}'; " + (f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}")
      )


def make_env(
  render_mode: str | None = None,
  seed: int | None = None,
  observation: str = "wide",
  normalised: bool = True,
  **options: Any,
) -> PathTrackingEnv:
  """One car as a gymnasium environment; further keyword arguments are the fields of `Options`.

  Args:
    seed: of the first episode; at random without it. `reset(seed=...)` goes before it.
  """
  cars = fleet(options_from(options), [secrets.randbits(62) if seed is None else seed])
  return PathTrackingEnv(cars, render_mode, interface_of(observation, normalised))


def make_vector_env(
  num_envs: int = 1, observation: str = "wide", normalised: bool = True, **options: Any
) -> FleetVectorEnv:
  """So many cars in one batch as gymnasium's vector environment; options as of `make_env`."""
  if num_envs < 1:
    raise ValueError(f"{num_envs} cars: at least one")
  cars = fleet(options_from(options), [secrets.randbits(62) for _ in range(num_envs)])
  return FleetVectorEnv(cars, interface_of(observation, normalised))


def register() -> None:
  """Make the environments known to gymnasium."""
  here = "agents.learning.environments"
  for name, given in ((ENV_ID, {}), (SI_ENV_ID, {"observation": "errors", "normalised": False})):
    if name not in gymnasium.registry:
      gymnasium.register(name, f"{here}:make_env", vector_entry_point=f"{here}:make_vector_env", kwargs=given)


register()
