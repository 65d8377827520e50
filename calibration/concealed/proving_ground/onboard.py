"""The independent car behind the interface of the QCar, in the place of a real one."""

from calibration.concealed.laboratory.written import stream
from calibration.concealed.proving_ground.effects import EFFECTS
from calibration.concealed.proving_ground.plant import ProvingGroundPlant
from calibration.concealed.proving_ground.session import Spec, drawn_car
from qcar_twin.onboard.plants import OnboardPlant
from qcar_twin.vehicle.vehicle import Vehicle


def sized(effect: str) -> tuple[str, float]:
  """NAME=SIZE as name and size in typical ones; 1 where none is given. Raises ValueError where it is no number."""
  name, _, size = effect.partition("=")
  try:
    return name, float(size or 1.0)
  except ValueError:
    raise ValueError(f"effect '{effect}' needs a number of typical sizes: {name}=1") from None


def _in_words(effect: str, size: float) -> str:
  kind = EFFECTS[effect]
  return f"{effect} = {size:g} x {kind.typical:g} {kind.unit}"


def independent_car(number: int, effects: tuple[str, ...], seed: int) -> OnboardPlant:
  """A car that shares no physics with the twin, with effects concealed in it.

  Args:
    number: seed of the car.
    effects: each "NAME=SIZE", or "NAME" for the typical size.
    seed: of its noise.

  Raises:
    ValueError: a size that is no number.  KeyError: no such effect.
  """
  hidden = tuple(map(sized, effects))
  car = drawn_car(Spec(number))
  table, std = car.measured(stream(number, 1))
  begin, sensors = ProvingGroundPlant(car, hidden, 1.0, seed).begin, f"independent car {number}"
  name = ", ".join([sensors, *(_in_words(*one) for one in sorted(hidden))])
  return OnboardPlant(begin, Vehicle.from_dataset(table, std), table, std, name, sensors=sensors)
