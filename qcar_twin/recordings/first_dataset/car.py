"""What [vehicle] of a first draft says: what a person said, what the log tells, and estimates for the rest."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from qcar_twin.recordings.checks.car import SIZES
from qcar_twin.recordings.recording import Recording
from qcar_twin.vehicle.similarity import POWERS, estimates
from qcar_twin.vehicle.vehicle import Vehicle

MARK = "guess:"
_WIDE = 0.3  # standard deviation of a number nobody measured, as a share of it
# of the wheelbase: where the centre of gravity lies along one that is known; axles carry 40 to 60 % of most cars
_ALONG = 0.05


def of_size(vehicle: Vehicle, wheelbase: float) -> Vehicle:
  """The same car at another wheelbase, m, with its centre of gravity at the same share of it."""
  lengths = {end: getattr(vehicle, end) * wheelbase / vehicle.wheelbase for end in ("cg_to_front", "cg_to_rear")}
  rest = estimates(lengths, {key: getattr(vehicle, key) for key in POWERS})
  kept = {"name": vehicle.name, "drive": vehicle.drive, "layout": vehicle.layout, "differential": vehicle.differential}
  kept |= {key: getattr(vehicle, key) for key in SIZES if key not in POWERS}
  return Vehicle.from_dataset(kept | lengths | rest)


@dataclass(frozen=True)
class Car:
  """The car of a first draft.

  Attributes:
    vehicle: of the kind whose command was logged, with its usual numbers.
    known: what its topics say, of a car that is known by them.
    drive, why_drive: kind of the drive, and the reason for it.
    said: wheelbase and wheel radius [m], mass [kg] and gear ratio where a person said them.
    turns_like: the wheelbase that the log turns like, m.
    gearing: the gear ratio at the vehicle's wheel radius, where measured speeds tell it.
  """

  vehicle: Vehicle
  known: Mapping[str, float | str]
  drive: str
  why_drive: str
  said: Mapping[str, float]
  turns_like: float
  gearing: float | None

  @property
  def _wheelbase(self) -> float:
    return self.said.get("wheelbase", self.turns_like)

  @property
  def _given(self) -> dict[str, float]:
    return {key: self.said[key] for key in self.said if key in SIZES}

  @property
  def _ends(self) -> dict[str, float]:
    ends = ("cg_to_front", "cg_to_rear")
    return {end: getattr(self.vehicle, end) * self._wheelbase / self.vehicle.wheelbase for end in ends}

  @property
  def sizes(self) -> dict[str, float]:
    """The numbers of [vehicle]: what a person said, and the rest estimated at the wheelbase that was said or that the
    log turns like; of a car that is known by its topics, its usual numbers."""
    usual = {key: getattr(self.vehicle, key) for key in POWERS}
    sizes = {key: getattr(self.vehicle, key) for key in SIZES}
    measured = self._ends | {key: self._given[key] for key in self._given if key in POWERS}
    sizes |= estimates(measured, usual) | self._ends | self._given
    if self.gearing is not None:
      sizes["gear_ratio"] = self.gearing * self.vehicle.wheel_radius / sizes["wheel_radius"]
    return sizes

  def lines(self, recordings: Sequence[Recording]) -> list[str]:
    """[vehicle] with wide deviations but for what was said; the supply is the recordings', as the guesses read them."""
    lines, vehicle, sizes = ["", "[vehicle]"], self.vehicle, self.sizes
    if self.known.get("name"):
      lines.append(f"name = {as_text(vehicle.name)}  # {MARK} by its topics")
    like = vehicle.name if self.known else "as a Quanser QCar"
    lines.append(f"layout = {as_text(vehicle.layout)}  # {MARK} {like}; rear or front drive?")
    if self.drive != "voltage":
      lines.append(f"drive = {as_text(self.drive)}  # {MARK} {self.why_drive}")
    supply = _usual_supply(recordings)
    if supply is not None:
      lines.append(f"supply_voltage = {supply:.4g}  # {MARK} the battery's median in these logs, V")
    elif self.drive == "duty":
      lines.append(f"supply_voltage = {vehicle.supply_voltage:.4g}  # {MARK} a usual battery's, V; voltages go by it")
    lines += [f"{key} = {_number(sizes[key])}  # {self._reason(key)}" for key in SIZES]
    lines += ["", "[vehicle.std]"]
    for key in (key for key in SIZES if key not in self._given):
      share, of, why = _WIDE, sizes[key], "as nobody measured it"
      if key in self._ends and "wheelbase" in self.said:
        share, of, why = _ALONG, self._wheelbase, "of the wheelbase that was said"
      lines.append(f"{key} = {_number(share * of)}  # {MARK} {100 * share:.0f} %{'' if share == _ALONG else ','} {why}")
    return lines

  def _reason(self, key: str) -> str:
    """Where one of the numbers comes from."""
    whose = f"the {self.vehicle.name}'s usual number" if self.known else "the Quanser QCar's number"
    if key in self._given:
      return "as said"
    if key == "gear_ratio" and self.gearing is not None:
      return f"{MARK} the log's speed over its motor speed, with that wheel_radius"
    if key in POWERS and "wheelbase" in self.said:
      whose = f"estimated from the wheelbase of {self.said['wheelbase']:g} m that was said"
    elif key in POWERS and self.turns_like != self.vehicle.wheelbase:
      whose = f"this log turns like a wheelbase of {self.turns_like:.3g} m; {whose} at that size"
    return f"{MARK} {whose}; measure yours"


def as_text(value: str) -> str:
  """As TOML has a text."""
  return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _usual_supply(recordings: Sequence[Recording]) -> float | None:
  """The battery's voltage, V, median over the logs; None where none was measured."""
  values = [recording["battery_voltage"].value for recording in recordings if "battery_voltage" in recording]
  return float(np.median(np.concatenate(values))) if values else None


def _number(value: float) -> str:
  """Six digits are more than any guess has."""
  return repr(float(f"{value:.6g}")) if math.isfinite(value) else "0.0"


def as_value(value: object) -> str:
  """As TOML has a flag, a text or a number of ten digits."""
  if isinstance(value, bool):
    return "true" if value else "false"
  return as_text(value) if isinstance(value, str) else repr(float(f"{value:.10g}"))
