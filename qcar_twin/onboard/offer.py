"""What a script can import while it runs, in the place of the libraries of the car, and what is said of the rest."""

import difflib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from qcar_twin.onboard.libraries import control, signals, timing
from qcar_twin.onboard.libraries.plots import Scope
from qcar_twin.onboard.pose_filter import QCarEKF
from qcar_twin.onboard.qcar import QCar
from qcar_twin.onboard.ranging import QCarGPS, QCarLidar
from qcar_twin.onboard.rig import Rig

ROOTS = ("pal", "hal", "quanser", "qvl", "pit", "pyqtgraph")  # packages of the car, and the one it draws with
ANY = ""  # in a module's table: what stands for every other name
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


class _Refused:
  """A class that there is nothing for: it is refused where it is made, and not where the owner's library has it."""


class NotOnBoard(RuntimeError):
  """A device that the simulated car does not have."""


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
    "pal.utilities.math": {n: getattr(signals, n) for n in ("wrap_to_pi", "wrap_to_2pi", "TWO_PI", "Calculus")},
    "pal.utilities.scope": dict.fromkeys(("Scope", "MultiScope", "XYScope", "Signal"), scope),
    "pal.utilities.timing": dict.fromkeys(("Timer", "QTimer"), timing.Timer),
    "pal.resources.images": dict.fromkeys(("SDCS_CITYSCAPE", "SDCS_CITYSCAPE_SMALL"), "no picture"),
    "hal.content.qcar_functions": {"QCarEKF": ekf, "QCarDriveController": control.QCarDriveController},
    "hal.products.qcar": {"QCarEKF": ekf, "QCarDriveController": control.QCarDriveController},
    "hal.utilities.control": {"PID": control.PID, "StanleyController": control.StanleyController},
    "pyqtgraph": {ANY: scope()},
    "pyqtgraph.Qt": {ANY: scope()},
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

  return type(name, (_Refused,), {"__init__": __init__})


def _is_refusal(what: Any) -> bool:
  return isinstance(what, type) and issubclass(what, _Refused)


class OfferedModules(importlib.abc.MetaPathFinder, importlib.abc.Loader):
  """Finds the modules of a table, those of the owner's own library where they are not in it, and nothing else.

  Args:
    table: module -> name -> what stands there.
    library: folder that holds the owner's `pal` and `hal`; None without one.
  """

  def __init__(self, table: Mapping[str, Mapping[str, Any]], library: Path | None = None):
    self._table, self._library = table, library
    self._own: dict[str, ModuleType] = {}
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
    if spec := self._in_library(fullname):
      return spec
    near = difflib.get_close_matches(fullname, self._table, n=2, cutoff=0.7)
    meant = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(sorted(self._table))}"
    raise NotOffered(f"the simulated car has no module '{fullname}'; {meant}", name=fullname)

  def exec_module(self, module: ModuleType) -> None:
    """Fill a module with what the table has for it."""
    listed = dict(self._table.get(module.__name__, {}))
    rest = listed.pop(ANY, None)
    others = self._absent(module.__name__, listed) if rest is None else lambda name: getattr(rest, name)
    there = {name: what for name, what in listed.items() if not _is_refusal(what)}
    vars(module).update(there, __all__=sorted(listed), __getattr__=others)

  def _in_library(self, fullname: str) -> importlib.machinery.ModuleSpec | None:
    """Where the owner's library has a module; None where it has not, or there is none."""
    if self._library is None:
      return None
    folder = self._library.joinpath(*fullname.split(".")[:-1])
    return importlib.machinery.PathFinder.find_spec(fullname, [str(folder)])

  def _absent(self, module: str, names: Mapping[str, Any]) -> Callable[[str], Any]:
    """What a module answers that is asked for a name there is nothing for: the owner's own, else a sentence."""

    def __getattr__(name: str) -> Any:
      if name.startswith("__"):
        raise AttributeError(f"module '{module}' has no attribute '{name}'")
      if hasattr(own := self._owner_s(module), name):
        return getattr(own, name)
      if name in names:
        return names[name]
      near = difflib.get_close_matches(name, names, n=2)
      listed = f"there are {', '.join(sorted(names))}" if names else "it holds modules only"
      there = f"did you mean {' or '.join(near)}?" if near else listed
      raise NotOffered(f"the simulated car has no '{name}' in {module}; {there}", name=module)

    return __getattr__

  def _owner_s(self, fullname: str) -> ModuleType | None:
    """The owner's own module of a name that the table has, too; None where it can't do without what is not offered."""
    if fullname not in self._own and (spec := self._in_library(fullname)) and spec.loader:
      own = importlib.util.module_from_spec(spec)
      try:
        spec.loader.exec_module(own)
      except NotOffered:
        own = ModuleType(fullname)
      self._own[fullname] = own
    return self._own.get(fullname)


def _parents(name: str) -> list[str]:
  parts = name.split(".")
  return [".".join(parts[:k]) for k in range(1, len(parts))]


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
