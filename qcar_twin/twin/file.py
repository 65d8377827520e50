"""A twin as a file: twin.toml holds the car, the fitted parameters and the mechanisms.

Every tool that simulates takes such a file, so a repaired twin is used like the first one.
"""

import dataclasses
import difflib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qcar_twin.atomic_io import write_text
from qcar_twin.plant import SUBSTEPS
from qcar_twin.twin.formula.mechanism import Formula
from qcar_twin.twin.formula.written import described, from_described
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.mechanisms.base import Mechanism
from qcar_twin.twin.twin import Twin
from qcar_twin.untrusted import UnreadableFile, is_number, read_toml
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
FORMAT = 1
# what every saved twin states of its car since format 1: one that is missing would be the QCar's
_OF_THE_CAR = (
  "mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius", "gear_ratio",
  "max_steering", "imu_x", "imu_y",
)  # fmt: skip


def save_twin(path: str | Path, twin: Twin, theta: Array, note: str = "", command_shift: int = 0) -> Path:
  """Write a twin; mechanisms at their null are left out.

  Args:
    path: file to write; replaced as a whole.
    twin: the car with its mechanisms.
    theta: parameter vector, (P,).
    note: what the file is, in words.
    command_shift: control periods by which commands act later than logged, as it was fitted with this twin.
  """
  values = twin.parameters.named(theta)
  if wrong := [name for name, value in values.items() if not np.isfinite(value)]:
    raise ValueError(f"{path}: {', '.join(wrong)} would be no finite number; nothing was written")
  present = [m for m in twin.mechanisms if twin.present(m, theta[None]) is not None]
  lines = [f"format = {FORMAT}", f"note = {_quoted(note)}", f"tyre = {_quoted(twin.tyre)}"]
  lines += [*([f"command_shift = {command_shift:d}"] if command_shift else []), "", "[vehicle]"]
  lines += _table({k: v for k, v in dataclasses.asdict(twin.vehicle).items() if k != "std"})
  lines += ["", "[vehicle.std]", *_table(twin.vehicle.std)]
  lines += ["", "[parameters]", *_table({p.name: values[p.name] for p in twin.base})]
  for mechanism in (m for m in present if isinstance(m, Formula)):
    lines += ["", f"[formulas.{mechanism.name}]", *(f"{k} = {json.dumps(v)}" for k, v in described(mechanism).items())]
  for mechanism in present:
    lines += ["", f"[mechanisms.{mechanism.name}]"]
    lines += _table({p.name: values[p.name] for p in mechanism.parameters})
  return write_text(path, "\n".join(lines) + "\n")


def load_twin(path: str | Path, substeps: int = SUBSTEPS, threads: int = 0) -> tuple[Twin, Array]:
  """A twin and its parameter vector from a file written by `save_twin`.

  Raises:
    FileNotFoundError, ValueError: with the file's name, the entry and the cure.
  """
  source = Path(path)
  table = _read(source)
  vehicle, values, mechanisms = (_part(source, table, name) for name in ("vehicle", "parameters", "mechanisms"))
  std, known = _numbers(source, "vehicle.std", vehicle.pop("std", {})), {f.name for f in dataclasses.fields(Vehicle)}
  if lacking := [name for name in _OF_THE_CAR if name not in vehicle]:
    raise UnreadableFile(f"{source}: [vehicle] lacks {', '.join(lacking)}: state them as they were when it was saved")
  if unknown := sorted(set(vehicle) - known):
    near = difflib.get_close_matches(unknown[0], known, n=1) or sorted(known)[:9]
    raise UnreadableFile(f"{source}: a vehicle has no '{unknown[0]}'; did you mean {', '.join(near)}?")
  try:
    car, tyre = Vehicle(**vehicle, std=std), table.get("tyre", "contact")
    twin = Twin(car, _known(source, table, mechanisms), tyre=tyre, substeps=substeps, threads=threads)
    numbers = _numbers(source, "parameters", values)
    for name, entries in mechanisms.items():
      numbers |= _numbers(source, f"mechanisms.{name}", entries)
    return twin, twin.parameters.vector(numbers)
  except (KeyError, ValueError) as error:
    if isinstance(error, UnreadableFile):
      raise
    raise UnreadableFile(f"{source}: {error.args[0]}") from error


def values_of(path: str | Path) -> dict[str, float]:
  """A twin file's parameters by name, with a `command_delay` that holds when its commands act.

  Raises:
    FileNotFoundError, ValueError: with the file's name, the entry and the cure.
  """
  twin, theta = load_twin(path, threads=1)
  values = twin.parameters.named(theta)
  return values | {"command_delay": values.get("command_delay", 0.0) + twin.period * command_shift_of(path)}


def command_shift_of(path: str | Path) -> int:
  """Control periods by which commands act later than logged, as a twin file says; 0 where it says nothing.

  Raises:
    FileNotFoundError, ValueError: with the file's name and the cure.
  """
  shift = _read(Path(path)).get("command_shift", 0)
  if not isinstance(shift, int) or isinstance(shift, bool):
    raise UnreadableFile(f"{path}: command_shift must be a whole number of control periods, not {shift!r:.40}")
  return shift


def _read(source: Path) -> dict[str, Any]:
  """What a twin file holds; of anything else the error says what it is, and what is wanted."""
  wanted = "give twin.toml, which qcar-twin calibrate and diagnose write"
  if source.is_dir():
    inside = source / "twin.toml"
    raise UnreadableFile(f"{source}: is a folder; " + (f"give {inside}" if inside.is_file() else wanted))
  if not source.is_file():
    raise FileNotFoundError(f"{source}: no such twin file; calibrate first (qcar-twin calibrate writes twin.toml)")
  if source.suffix.lower() != ".toml":
    kind = f"a {source.suffix} file" if source.suffix else "a file without an ending"
    raise UnreadableFile(f"{source}: is {kind}, not a twin file; {wanted}")
  table = read_toml(source)
  if "recording" in table or "channels" in table:
    raise UnreadableFile(f"{source}: describes a data set, not a twin; calibrate it first, and {wanted}")
  if table.get("format") != FORMAT:
    raise UnreadableFile(f"{source}: not a twin file of format {FORMAT}; write it again with qcar-twin calibrate")
  return table


def _known(source: Path, table: Mapping[str, Any], names: Mapping[str, Any]) -> list[Mechanism]:
  """Mechanisms by name: formulas that the file itself describes, as data, and those of the catalogue."""
  formulas = table.get("formulas", {})
  if not isinstance(formulas, dict):
    raise UnreadableFile(f"{source}: [formulas] must be a table; write it again with qcar-twin diagnose")
  made = {}
  for name, content in formulas.items():
    try:
      made[name] = from_described(name, content)
    except (KeyError, TypeError, ValueError) as error:
      raise UnreadableFile(f"{source}: [formulas.{name}] is not a formula: {error}") from error
  return [made[name] if name in made else select([name])[0] for name in names]


def _part(source: Path, table: Mapping[str, Any], name: str) -> dict[str, Any]:
  """One of the file's tables; only the mechanisms' may be absent."""
  part = table.get(name, {} if name == "mechanisms" else None)
  if not isinstance(part, dict):
    raise UnreadableFile(f"{source}: has no table [{name}]; write it again with qcar-twin calibrate")
  return dict(part)


def _numbers(source: Path, where: str, table: Any) -> dict[str, float]:
  """A table of finite numbers."""
  if not isinstance(table, dict):
    raise UnreadableFile(f"{source}: [{where}] must be a table of numbers, not {table!r:.60}")
  for name, value in table.items():
    if not is_number(value):
      raise UnreadableFile(f"{source}: [{where}] {name} must be a finite number, not {value!r:.60}")
  return {name: float(value) for name, value in table.items()}


def _table(values: Mapping[str, object]) -> list[str]:
  return [f"{name} = {_literal(value)}" for name, value in values.items()]


def _literal(value: object) -> str:
  if isinstance(value, str):
    return _quoted(value)
  number = float(value)  # type: ignore[arg-type]
  if np.isinf(number):
    return "inf" if number > 0 else "-inf"
  return repr(number)


def _quoted(text: str) -> str:
  return json.dumps(text, ensure_ascii=False)
