"""Calibration of the twin on recordings, cross-validation, and diagnosis of missing physics.

  from calibration import calibrate, cross_validate, diagnose

Each name is imported when it is first asked for, so that the proving ground never loads the twin.
"""

from importlib import import_module
from typing import Any

_ROOMS = {
  "calibrate": "twin_calibration",
  "cross_validate": "cross_validation",
  "diagnose": "diagnosis",
  "draw_cases": "concealed.campaign",
  "identify": "identification",
  "make_session": "concealed.proving_ground",
  "run_case": "concealed.campaign",
  "shipped": "diagnosis.shipping",
}
__all__ = list(_ROOMS)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
  if name not in _ROOMS:
    raise AttributeError(f"calibration has no '{name}'; it offers {', '.join(__all__)}")
  return getattr(import_module(f"calibration.{_ROOMS[name]}"), name)
