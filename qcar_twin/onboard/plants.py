"""What a script can drive: any simulator of one car that goes by motor voltage, or duty, and steering angle."""

import dataclasses
import difflib
import hashlib
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Simulation
from qcar_twin.twin.engines import EngineKind
from qcar_twin.twin.mechanisms import catalogue
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
_MEMORY = 200  # control periods that a late sensor is looked up in: 2 s, ten times the latest that the catalogue has


@dataclasses.dataclass(frozen=True)
class OnboardPlant:
  """One car to be driven.

  Attributes:
    begin: puts the car to a start, (1, 7) in the order of `plant.START`; signals are as its sensors see them, before
      noise.
    vehicle: its measured numbers.
    table, std: what is written of it as a data set's [vehicle].
    name: what it is, with the effects in it, for the data set: drives of one name are drives of one car.
    period: control period, s.
    sensors: whose noise they have. Twins share one, so that two of them differ by their physics alone; another car has
      its own, since no twin repeats the noise of the car that it is compared with.
  """

  begin: Callable[[Array], Simulation]
  vehicle: Vehicle
  table: Mapping[str, float | str]
  std: Mapping[str, float]
  name: str
  period: float = 0.01
  sensors: str = "twin"

  def __post_init__(self) -> None:
    if self.vehicle.drive not in ("voltage", "duty"):
      raise ValueError(
        f"{self.vehicle.name} is driven by {self.vehicle.drive}, and a QCar's throttle is a duty: drive a twin of a car"
        ' with drive = "voltage" or "duty"'
      )


def twin_plant(twin: Twin, theta: Array, engine: EngineKind = "mujoco") -> OnboardPlant:
  """A twin with parameters (P,); its sensor-side mechanisms act on what is read on board."""
  driven = twin.on(engine)

  def begin(start: Array) -> Simulation:
    return _SensedCar(driven, theta, start)

  return OnboardPlant(
    begin, driven.vehicle, vehicle_table(driven.vehicle), driven.vehicle.std, _named(driven, theta, engine)
  )


def _named(twin: Twin, theta: Array, engine: EngineKind) -> str:
  """A twin by its engine, a digest of its base's parameters, and the mechanisms that are present in it."""
  values = twin.parameters.named(theta)
  base = ",".join(f"{p.name}={values[p.name]:.9g}" for p in twin.base)
  present = [m for m in twin.mechanisms if twin.present(m, theta[None]) is not None]
  added = [f"{p.name} = {values[p.name]:.6g}" for m in present for p in m.parameters]
  return ", ".join([f"{engine} twin {hashlib.sha256(base.encode()).hexdigest()[:8]}", *added])


def vehicle_table(vehicle: Vehicle) -> dict[str, float | str]:
  """A data set's [vehicle] of a car: everything that is finite."""
  entries = {k: v for k, v in dataclasses.asdict(vehicle).items() if k not in ("std", "name")}
  return {k: v for k, v in entries.items() if isinstance(v, str) or np.isfinite(v)}


class _SensedCar:
  """One car of a twin under way, as its sensors see it."""

  def __init__(self, twin: Twin, theta: Array, start: Array):
    self._twin, self._theta = twin, theta[None]
    self._simulation = twin.begin(self._theta, start)
    self._senses = any(m.stage == "sensor" and twin.present(m, self._theta) is not None for m in twin.mechanisms)
    self._past, self._steps = np.array(self._simulation.signals), 0  # (T, 10) of the last seconds
    self.signals = self._seen()

  def step(self, commands: Array) -> Array:
    """As of `plant.Simulation`."""
    self._past = np.concatenate([self._past[-_MEMORY:], self._simulation.step(commands)])
    self._steps += 1
    self.signals = self._seen()
    return self.signals

  def _seen(self) -> Array:
    if not self._senses:
      return self._past[-1:].copy()
    first = (self._steps + 1 - len(self._past)) * self._twin.period
    return self._twin.sensed(self._theta, self._past[None].copy(), np.array([first]))[0, -1:]


def with_effects(twin: Twin, theta: Array, effects: Sequence[str]) -> tuple[Twin, Array]:
  """The twin with effects added, each "NAME=VALUE": a parameter of the catalogue, or a mechanism and its first one.

  Raises:
    ValueError: no such name, no number, or one outside the parameter's bounds; the text says what there is.
  """
  values = twin.parameters.named(theta)
  mechanisms = {m.name: m for m in twin.mechanisms}
  for effect in effects:
    name, _, text = effect.partition("=")
    mechanism, parameter = _effect(name.strip())
    values[parameter.name] = _number(effect, text, parameter)
    mechanisms.setdefault(mechanism.name, mechanism)
  changed = twin.with_mechanisms(tuple(mechanisms.values()))
  return changed, changed.parameters.vector(values)


def _effect(name: str) -> tuple[Mechanism, Parameter]:
  known = catalogue()
  if name in known:
    return known[name], known[name].parameters[0]
  by_parameter = {p.name: (m, p) for m in known.values() for p in m.parameters}
  if name in by_parameter:
    return by_parameter[name]
  near = difflib.get_close_matches(name, sorted({*known, *by_parameter}), n=3) or sorted(known)
  raise ValueError(f"no effect '{name}'; did you mean {', '.join(near)}?")


def _number(effect: str, text: str, parameter: Parameter) -> float:
  said = f"{parameter.name} in {parameter.unit}, from {parameter.lower:g} to {parameter.upper:g}"
  try:
    value = float(text)
  except ValueError:
    raise ValueError(f"effect '{effect}' needs a number: {parameter.name}={parameter.typical or 1:g}, {said}") from None
  if not parameter.lower <= value <= parameter.upper:
    raise ValueError(f"effect '{effect}' is out of bounds: give {said}")
  return value
