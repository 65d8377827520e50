"""The identified model that controllers and filter are built on, and the plants they are tried on."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from agents.control.speed import SpeedGains
from qcar_twin.bicycle.bicycle import Bicycle
from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.cures import RENAMED_PLANTS
from qcar_twin.estimation.settings import FilterSettings
from qcar_twin.plant import Plant
from qcar_twin.twin.engines import ENGINES
from qcar_twin.twin.file import load_twin
from qcar_twin.twin.parameters import drive_response
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.drive import DRIVES
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
# s, given to the filter: delay and lag as one
STEERING_LAG = {"bicycle": 0.05, "mujoco": 0.015, "reduced": 0.015, "proving_ground": 0.05}


@dataclasses.dataclass(frozen=True)
class Model:
  """A vehicle with the five identified numbers of its single track.

  Attributes:
    vehicle: measured numbers.  theta: of `Bicycle`, (5,).
  """

  vehicle: Vehicle
  theta: Array

  @classmethod
  def nominal(cls) -> "Model":
    """The QCar's measured numbers and the nominal bicycle."""
    vehicle = Vehicle.load()
    return cls(vehicle, Bicycle(vehicle).parameters.nominal)

  @classmethod
  def of_twin(cls, twin: Twin, theta: Array) -> "Model":
    """The car of a twin with parameters (P,): its vehicle, and the single track that its fitted numbers give."""
    base = twin.base.replace(
      **{p.name: dataclasses.replace(p, nominal=float(v)) for p, v in zip(twin.base, theta, strict=False)}
    )
    tyres = [base[f"cornering_stiffness_{axle}"].nominal for axle in ("front", "rear")]
    return cls(twin.vehicle, np.array([*drive_response(twin.vehicle, base), *tyres]))

  @classmethod
  def of_file(cls, twin_file: str) -> "Model":
    """The car of a twin file; the QCar where none is named."""
    return cls.of_twin(*load_twin(twin_file, threads=1)) if twin_file else cls.nominal()

  @property
  def car(self) -> SingleTrackCar:
    """Numbers of the equations."""
    return Bicycle(self.vehicle).car(self.theta)

  @property
  def speed_gains(self) -> SpeedGains:
    """Of the speed control, in the drive's own commands: at most three nominal cells of a voltage, all of a duty, as
    much as it takes of a current or a speed."""
    if self.vehicle.drive == "voltage":
      return SpeedGains.design(self.car)
    limit = 1.0 if self.vehicle.drive == "duty" else np.inf
    return SpeedGains.design(self.car, limit=limit, unit=DRIVES[self.vehicle.drive].unit)

  def plant(self, name: str, twin_file: str = "") -> tuple[Plant, Array]:
    """A plant by name and its parameter vector: "mujoco", the twin (nominal, or of a twin file) in MuJoCo; "reduced",
    the same twin on the reduced car; "bicycle", this model.

    Raises:
      KeyError: another name.
    """
    if name == "bicycle":
      return Bicycle(self.vehicle), self.theta
    if name in ENGINES:
      twin = Twin(self.vehicle, threads=1)
      theta = twin.parameters.nominal
      if twin_file:
        twin, theta = load_twin(twin_file, threads=1)
      return twin.on(name), theta
    called = f"it is called {RENAMED_PLANTS[name]} now; " if name in RENAMED_PLANTS else ""
    raise KeyError(f"no plant '{name}'; {called}there are mujoco, reduced and bicycle")

  def filter_settings(self, plant: str, **changes: object) -> FilterSettings:
    """Settings of the federated filter for a plant: its IMU's place, its steering's lag, the lidar's colour."""
    base = FilterSettings.of_vehicle(self.vehicle, steering_lag=STEERING_LAG[plant], lidar_correlation=0.3)
    if plant == "bicycle":  # all its wheels go as fast as the car
      base = dataclasses.replace(base, front_drive_share=0.0)
    return dataclasses.replace(base, **changes)


def known_of_twin(file: str) -> dict[str, float]:
  """What a twin file says of the car as it drives, by name in SI units: what a filter in a simulation may be told.

  Left out are the errors of its sensors, of mechanisms that act on what is measured: sensors that are simulated
  measure a plant's true signals with noise of their own, and a filter would take out an error that nothing has.

  Raises:
    UnreadableFile: it is no twin file.
  """
  twin, theta = load_twin(file, threads=1)
  measured = {p.name for mechanism in twin.mechanisms if mechanism.stage == "sensor" for p in mechanism.parameters}
  return {name: value for name, value in twin.parameters.named(theta).items() if name not in measured}
