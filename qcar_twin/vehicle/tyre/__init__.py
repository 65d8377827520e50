"""The tyre inside the contact solver: a MuJoCo plugin, its loader, its parameters. See docs/reference/tyre.md."""

import threading

import mujoco

from qcar_twin.vehicle.tyre.laws import law_parameters, slip_over_linear, tyre_laws
from qcar_twin.vehicle.tyre.parameters import COLUMN, tyre_user_data

PLUGIN = "qcar.tyre"
_lock = threading.Lock()
_loaded: list[str] = []

__all__ = [
  "COLUMN", "PLUGIN", "add_tyres", "law_parameters", "load_plugin", "slip_over_linear", "tyre_laws", "tyre_user_data",
]  # fmt: skip


def load_plugin() -> None:
  """Make the plugin known to MuJoCo in this process, building it if need be. Calling it again does nothing.

  Raises:
    BuildError: it cannot be built; the message says what to do.
  """
  with _lock:
    if not _loaded:
      from qcar_twin.vehicle.tyre.build import (
        build,  # here, so that `python -m qcar_twin.vehicle.tyre.build` runs it once
      )

      library = build()
      mujoco.mj_loadPluginLibrary(str(library))
      _loaded.append(str(library))


def add_tyres(spec: mujoco.MjSpec, chassis: str, tyres: dict[str, list[float]]) -> None:
  """Give the wheels below one body tyres instead of MuJoCo's friction.

  Args:
    spec: model under construction.
    chassis: body that carries the plugin instance; the parent of the wheel bodies.
    tyres: name of wheel geom -> its vector from `tyre_user_data`.
  """
  load_plugin()
  spec.activate_plugin(PLUGIN)
  spec.nuser_geom = max(spec.nuser_geom, len(COLUMN))
  spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
  spec.body(chassis).plugin = spec.add_plugin(name=f"{chassis}_tyres", plugin_name=PLUGIN, active=True)
  for name, vector in tyres.items():
    spec.geom(name).userdata = vector
