"""A twin as a file: twin.toml holds the car, the fitted parameters and the mechanisms.

Every tool that simulates takes such a file, so a repaired twin is used like the first one.
"""

import dataclasses
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from qcar_twin.atomic_io import write_text
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle

Array = NDArray[np.float64]
FORMAT = 1


def save_twin(path: str | Path, twin: Twin, theta: Array, note: str = "") -> Path:
  """Write a twin; mechanisms at their null are left out.

  Args:
    path: file to write; replaced as a whole.
    twin: the car with its mechanisms.
    theta: parameter vector, (P,).
    note: what the file is, in words.
  """
  values = twin.parameters.named(theta)
  present = [m for m in twin.mechanisms if twin.present(m, theta[None]) is not None]
  lines = [f"format = {FORMAT}", f"note = {_quoted(note)}", f"tyre = {_quoted(twin.tyre)}", "", "[vehicle]"]
  lines += _table({k: v for k, v in dataclasses.asdict(twin.vehicle).items() if k != "std"})
  lines += ["", "[vehicle.std]", *_table(twin.vehicle.std)]
  lines += ["", "[parameters]", *_table({p.name: values[p.name] for p in twin.base})]
  for mechanism in present:
    lines += ["", f"[mechanisms.{mechanism.name}]"]
    lines += _table({p.name: values[p.name] for p in mechanism.parameters})
  return write_text(path, "\n".join(lines) + "\n")


def load_twin(path: str | Path, substeps: int = 5, threads: int = 0) -> tuple[Twin, Array]:
  """A twin and its parameter vector from a file written by `save_twin`.

  Raises:
    FileNotFoundError, ValueError: with the file's name, the entry and the cure.
  """
  source = Path(path)
  if not source.is_file():
    raise FileNotFoundError(f"{source}: no such twin file; calibrate first (qcar-twin calibrate writes twin.toml)")
  with open(source, "rb") as file:
    try:
      table = tomllib.load(file)
    except tomllib.TOMLDecodeError as error:
      raise ValueError(f"{source}: not a valid TOML file: {error}") from error
  if table.get("format") != FORMAT or "vehicle" not in table or "parameters" not in table:
    raise ValueError(f"{source}: not a twin file of format {FORMAT}; write it again with qcar-twin calibrate")
  numbers = dict(table["vehicle"])
  std = numbers.pop("std", {})
  vehicle = Vehicle(**numbers, std=std)
  mechanisms = table.get("mechanisms", {})
  twin = Twin(vehicle, select(mechanisms), tyre=table.get("tyre", "contact"), substeps=substeps, threads=threads)
  values = dict(table["parameters"])
  for entries in mechanisms.values():
    values |= entries
  try:
    return twin, twin.parameters.vector(values)
  except KeyError as error:
    raise ValueError(f"{source}: {error.args[0]}") from error


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
