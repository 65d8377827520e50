"""The controllers that are compared: weights and their origin from agents/data/controllers.toml, gains computed."""

import dataclasses
import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.control.feedforward import FeedforwardFeedback
from agents.control.interface import Controller
from agents.control.linear_rate import LinearRate
from agents.control.lq import LqCm, LqEd
from qcar_twin.atomic_io import write_text
from qcar_twin.bicycle.single_track import SingleTrackCar
from qcar_twin.recordings.recording import nearest
from qcar_twin.untrusted import UnreadableFile, is_number, read_toml
from qcar_twin.vehicle.vehicle import QCAR

FILE = Path(__file__).resolve().parents[1] / "data" / "controllers.toml"
VERSIONS = ("loose", "tuned")


@dataclasses.dataclass(frozen=True)
class Family:
  """One kind of controller as a search sees it.

  Attributes:
    name: of the controller.
    numbers: what its file entry holds, in order.
    start: where a search begins, positive.
    spread: of the search's first generation, in decades.
  """

  name: str
  numbers: tuple[str, ...]
  start: tuple[float, ...]
  spread: float = 0.7


WEIGHTS = ("cross_track_rate", "heading", "heading_rate", "effort")  # against a weight of 1 on the cross-track error
FAMILIES = {
  family.name: family
  for family in (
    Family("ff_fb", ("gain", "preview"), (1.5, 0.5), 0.3),
    Family("lq_ed", WEIGHTS, (0.1, 0.1, 0.01, 0.03)),
    Family("lq_cm", WEIGHTS, (0.1, 0.1, 0.01, 0.1)),
    Family("linear_rate", ("cross_track", "cross_track_rate", "heading", "heading_rate"), (60.0, 20.0, 40.0, 5.0), 0.4),
  )
}


def make(
  name: str, numbers: Mapping[str, float], car: SingleTrackCar, speed: float, lock: float = QCAR.max_steering
) -> Controller:
  """A controller from its numbers; LQ gains come from the identified model at `speed` m/s.

  Raises:
    KeyError: unknown controller, with the nearest name.
  """
  if name not in FAMILIES:
    near = difflib.get_close_matches(name, FAMILIES, n=1) or list(FAMILIES)
    raise KeyError(f"no controller '{name}'; did you mean {', '.join(near)}?")
  missing = [n for n in FAMILIES[name].numbers if not is_number(numbers.get(n))]
  if missing:
    raise KeyError(f"controller '{name}' lacks the numbers {', '.join(missing)}")
  if name == "ff_fb":
    return FeedforwardFeedback(car, numbers["gain"], numbers["preview"])
  if name == "linear_rate":
    return LinearRate(np.array([numbers[n] for n in FAMILIES[name].numbers]), lock=lock)
  weights = (1.0, numbers["cross_track_rate"], numbers["heading"], numbers["heading_rate"])
  return (LqEd if name == "lq_ed" else LqCm).design(car, speed, weights, numbers["effort"])


def side_by_side(controllers: list[Controller], repeats: int) -> Controller:
  """Several controllers of one kind as one, each driving `repeats` neighbouring cars."""
  first = controllers[0]
  if isinstance(first, FeedforwardFeedback):
    alike = [c for c in controllers if isinstance(c, FeedforwardFeedback)]
    gain, preview = (np.array([getattr(c, n) for c in alike], dtype=np.float64) for n in ("gain", "preview"))
    return FeedforwardFeedback(first.car, np.repeat(gain, repeats), np.repeat(preview, repeats))
  if not isinstance(first, (LqEd, LqCm, LinearRate)):
    raise TypeError(f"controllers of kind {type(first).__name__} cannot be put side by side")
  gains = [np.asarray(c.gain) for c in controllers if isinstance(c, (LqEd, LqCm, LinearRate))]
  return dataclasses.replace(first, gain=np.repeat(gains, repeats, axis=0))


def load(car: SingleTrackCar, speed: float = 0.5, file: Path = FILE) -> dict[tuple[str, str], Controller]:
  """All controllers of a file by (name, version), for a car at a speed, m/s.

  Raises:
    FileNotFoundError: there is no file yet.
  """
  if not file.exists():
    raise FileNotFoundError(f"{file} does not exist; run qcar-twin tune to make it")
  try:
    return {
      (name, version): make(name, entry, car, speed)
      for name, versions in entries(file).items()
      for version, entry in versions.items()
    }
  except (KeyError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
    raise UnreadableFile(f"{file.name}: {error.args[0]}; run qcar-twin tune to make it again") from error


def entries(file: Path = FILE) -> dict[str, dict[str, dict[str, Any]]]:
  """The file as it is: name -> version -> numbers and provenance; empty when there is none.

  Raises:
    UnreadableFile: it is something else.
  """
  table = read_toml(file) if file.exists() else {}
  for name, versions in table.items():
    for version, entry in versions.items() if isinstance(versions, dict) else [("", None)]:
      if not isinstance(entry, dict) or not all(isinstance(x, str) or is_number(x) for x in entry.values()):
        raise UnreadableFile(f"{file}: [{name}.{version}] must be a table of finite numbers; run qcar-twin tune")
  return table


def entry(name: str, version: str) -> dict[str, Any]:
  """Numbers and provenance of one version of a controller. Raises ValueError where the file has none, with the nearest
  name."""
  table = entries()
  if name not in table:
    raise ValueError(f"no controller '{name}'{nearest(name, table)}")
  if version not in table[name]:
    raise ValueError(f"no version '{version}' of controller '{name}'{nearest(version, table[name])}")
  return table[name][version]


def save(table: Mapping[str, Mapping[str, Mapping[str, Any]]], file: Path = FILE) -> None:
  """Write entries, replacing the file in one go."""
  lines = [
    "# Path-tracking controllers. LQ gains are computed from these weights and the identified model; made by "
    "qcar-twin tune."
  ]
  for name, versions in table.items():
    for version, entry in versions.items():
      lines += ["", f"[{name}.{version}]"]
      lines += [f"{key} = {_toml(value)}" for key, value in entry.items()]
  write_text(file, "\n".join(lines) + "\n")


def _toml(value: Any) -> str:
  if isinstance(value, str):
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
  return f"{value:.5g}" if isinstance(value, float) else str(value)
