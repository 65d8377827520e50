"""What a script can import while it runs, in the place of the libraries of the car, and what is said of the rest."""

import difflib
import importlib.abc
import importlib.machinery
import importlib.util
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from qcar_twin.onboard.pose_filter import QCarEKF
from qcar_twin.onboard.qcar import QCar
from qcar_twin.onboard.ranging import QCarGPS, QCarLidar
from qcar_twin.onboard.rig import Rig

ROOTS = ("pal", "hal", "quanser", "qvl", "pit")  # packages that belong to the car
_CAMERA = "the simulated car has no camera; drive a script that goes by speed, gyro, pose or lidar"
_PERSON = "nobody is at the controls of a simulated car; command it from the script"
_NETWORK = "there is no other device to talk to on simulated time; take it out, or drive the part without it"
_MAP = (
  "the road map of the manufacturer's mat is not part of this project; give waypoints, or --library with its folder"
)
_REFUSED = {
  "pal.products.qcar": {"QCarCameras": _CAMERA, "QCarRealSense": _CAMERA, "QCar2DepthAligned": _CAMERA},
  "pal.utilities.vision": {"Camera2D": _CAMERA, "Camera3D": _CAMERA},
  "pal.utilities.gamepad": {"LogitechF710": _PERSON},
  "pal.utilities.keyboard": {"QKeyboard": _PERSON, "KeyboardDrive": _PERSON},
  "pal.utilities.stream": {"BasicStream": _NETWORK, "Timeout": _NETWORK},
  "pal.utilities.probe": {"Probe": _NETWORK, "Observer": _NETWORK},
  "pal.products.traffic_light": {"TrafficLight": _NETWORK},
  "hal.utilities.image_processing": {"ImageProcessing": _CAMERA},
  "hal.products.mats": {"SDCSRoadMap": _MAP},
}


class NotOffered(ModuleNotFoundError):
  """A module or a name of the car's libraries that there is nothing for; the text says what there is."""


class NotOnBoard(RuntimeError):
  """A device that the simulated car does not have."""


class Scope:
  """A plot that is shown nowhere: whatever it is asked, it takes and forgets; the recording has the signals."""

  rig: ClassVar[Rig]

  def __init__(self, *_: Any, **__: Any):
    self.axes = _Axes(self)

  def __getattr__(self, name: str) -> Any:
    if name.startswith("__"):
      raise AttributeError(name)
    return lambda *_, **__: self.refreshAll()

  @classmethod
  def refreshAll(cls) -> None:
    """Nothing is drawn, which takes a moment: scripts wait by it."""
    cls.rig.clock.read()


class _Axes:
  """Axes of a plot, as many as are asked for."""

  def __init__(self, scope: Scope):
    self._scope = scope

  def __getitem__(self, _: int) -> Scope:
    return self._scope


def wrap_to_pi(angle: Any) -> Any:
  """Angle within half a turn, rad."""
  return np.mod(np.asarray(angle) + math.pi, math.tau)[()] - math.pi


def wrap_to_2pi(angle: Any) -> Any:
  """Angle within a turn from 0, rad."""
  return np.mod(angle, math.tau)


def offered(rig: Rig) -> dict[str, dict[str, Any]]:
  """Module -> name -> what stands there, for one drive."""
  bound = {kind.__name__: type(kind.__name__, (kind,), {"rig": rig}) for kind in (QCar, QCarGPS, QCarLidar)}
  scope = type("Scope", (Scope,), {"rig": rig})
  vehicle = rig.car.vehicle
  numbers = {"WHEEL_RADIUS": vehicle.wheel_radius, "WHEEL_BASE": vehicle.wheelbase, "cartype": 1, "carname": "qcar"}
  ekf = type("QCarEKF", (QCarEKF,), {"__init__": _with_wheelbase(vehicle.wheelbase)})
  table = {
    "pal.products.qcar": {**bound, "IS_PHYSICAL_QCAR": True, "QCAR_CONFIG": numbers},
    "pal.utilities.lidar": {"Lidar": bound["QCarLidar"]},
    "pal.utilities.math": {"wrap_to_pi": wrap_to_pi, "wrap_to_2pi": wrap_to_2pi, "TWO_PI": math.tau},
    "pal.utilities.scope": dict.fromkeys(("Scope", "MultiScope", "XYScope", "Signal"), scope),
    "hal.content.qcar_functions": {"QCarEKF": ekf},
    "hal.products.qcar": {"QCarEKF": ekf},
  }
  for module, refused in _REFUSED.items():
    table.setdefault(module, {}).update({name: _refusal(name, why) for name, why in refused.items()})
  return table


def _with_wheelbase(wheelbase: float) -> Any:
  def __init__(self: QCarEKF, x_0: Any = (0, 0, 0), Q: Any = None, R: Any = None, L: float = wheelbase) -> None:
    QCarEKF.__init__(self, x_0, Q, R, L)

  return __init__


def _refusal(name: str, why: str) -> type:
  """A class that can be imported and not be made."""

  def __init__(self: object, *_: Any, **__: Any) -> None:
    raise NotOnBoard(f"{name}: {why}")

  return type(name, (), {"__init__": __init__})


class OfferedModules(importlib.abc.MetaPathFinder, importlib.abc.Loader):
  """Finds the modules of a table, those of the owner's own library where they are not in it, and nothing else.

  Args:
    table: module -> name -> what stands there.
    library: folder that holds the owner's `pal` and `hal`; None without one.
  """

  def __init__(self, table: Mapping[str, Mapping[str, Any]], library: Path | None = None):
    self._table, self._library = table, library
    self._packages = {part for name in table for part in _parents(name)}

  def find_spec(
    self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
  ) -> importlib.machinery.ModuleSpec | None:
    """Where a module is; None for one that is not of the car's libraries.

    Raises:
      NotOffered: it is, and there is nothing for it.
    """
    if fullname.split(".")[0] not in ROOTS:
      return None
    if fullname in self._table or fullname in self._packages:
      return importlib.machinery.ModuleSpec(fullname, self, is_package=fullname in self._packages)
    if self._library is not None:
      folder = self._library.joinpath(*fullname.split(".")[:-1])
      if spec := importlib.machinery.PathFinder.find_spec(fullname, [str(folder)]):
        return spec
    near = difflib.get_close_matches(fullname, self._table, n=2, cutoff=0.7)
    meant = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(sorted(self._table))}"
    raise NotOffered(f"the simulated car has no module '{fullname}'; {meant}", name=fullname)

  def exec_module(self, module: ModuleType) -> None:
    """Fill a module with what the table has for it."""
    names = dict(self._table.get(module.__name__, {}))
    vars(module).update(names, __all__=sorted(names), __getattr__=_absent(module.__name__, names))


def _parents(name: str) -> list[str]:
  parts = name.split(".")
  return [".".join(parts[:k]) for k in range(1, len(parts))]


def _absent(module: str, names: Mapping[str, Any]) -> Any:
  """What a module answers that is asked for a name it has not."""

  def __getattr__(name: str) -> Any:
    if name.startswith("__"):
      raise AttributeError(f"module '{module}' has no attribute '{name}'")
    near = difflib.get_close_matches(name, names, n=2)
    listed = f"there are {', '.join(sorted(names))}" if names else "it holds modules only"
    there = f"did you mean {' or '.join(near)}?" if near else listed
    raise NotOffered(f"the simulated car has no '{name}' in {module}; {there}", name=module)

  return __getattr__


@contextmanager
def in_place(finder: OfferedModules) -> Iterator[None]:
  """Let imports find the offered modules; what was imported under these names before is back afterwards."""
  of_car = lambda name: name.split(".")[0] in ROOTS
  before = {name: module for name, module in sys.modules.items() if of_car(name)}
  for name in before:
    del sys.modules[name]
  sys.meta_path.insert(0, finder)
  try:
    yield
  finally:
    sys.meta_path.remove(finder)
    for name in [name for name in sys.modules if of_car(name)]:
      del sys.modules[name]
    sys.modules.update(before)
