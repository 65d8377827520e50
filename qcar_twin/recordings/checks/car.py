"""Can [vehicle] be a car? Numbers that belong together, by ratios that hold from a 1:43 model to a full-size car."""

from __future__ import annotations

from collections.abc import Mapping

from qcar_twin.recordings.channels import CHANNELS
from qcar_twin.recordings.recording import RecordingError

# mass / wheelbase^3, kg/m^3: a full-size car 1500 kg, 2.8 m has 70, a 1:10 car 160 to 300, a 1:43 model 230; a gram
# or a centimetre in place of the SI unit is out by a thousand and more
_DENSITY = (5.0, 5000.0)
# yaw_inertia / (mass wheelbase^2): (k/L)^2 with a radius of gyration k of 0.2 to 1 wheelbase; cars have 0.1 to 0.25
_GYRATION = (0.02, 1.0)
SIZES = ("mass", "yaw_inertia", "cg_to_front", "cg_to_rear", "track_width", "cg_height", "wheel_radius", "gear_ratio",
         "max_steering")  # fmt: skip
_SHORTEST, _LONGEST = 0.02, 8.0  # m, of the wheelbase of a 1:87 model and of a lorry
_APART = 20.0  # of the two ends' distances to the centre of gravity; a car has it between its axles
# by the wheelbase: wheels of a car are 0.1 to 0.25, its track 0.4 to 1.1, its centre of gravity 0.1 to 0.4
_LENGTHS = {"wheel_radius": (0.02, 0.6), "track_width": (0.15, 3.0), "cg_height": (0.02, 1.5)}
_WIDEST = 1.0  # deviation of a positive number as a share of it: beyond it the number says nothing
_CELL = 3.0  # V, of one lithium cell that is empty: no car's battery has less
_SMALLER = {"mass": ("g", 1e-3), "yaw_inertia": ("kg cm^2", 1e-4), "gear_ratio": ("per cent", 1e-2),
            "max_steering": ("degrees", 0.0174533)}  # fmt: skip
_MILLIMETRES = ("mm", 1e-3)


def check_car(vehicle: Mapping[str, float | str], where: str, std: Mapping[str, float] | None = None) -> None:
  """Raises RecordingError for numbers that cannot be one car's in SI units, with the unit that makes them so.

  Args:
    std: standard deviations by number.
  """
  number = lambda key: float(vehicle[key])
  _check_wheelbase(vehicle, where, std or {})
  _check_supply(vehicle, where)
  if "gear_ratio" in vehicle and number("gear_ratio") > 1.0:
    gear = number("gear_ratio")
    raise RecordingError(
      f"{where} gear_ratio is wheel speed / motor speed, and {gear:g} would drive the wheels faster than the motor; it "
      f"is inverted: write {1.0 / gear:.6g}"
    )
  if not {"cg_to_front", "cg_to_rear"} <= set(vehicle):
    return
  wheelbase = number("cg_to_front") + number("cg_to_rear")
  if "mass" in vehicle:
    _check_ends({key: number(key) for key in ("cg_to_front", "cg_to_rear")}, number("mass"), where)
    _check_mass(number("mass"), wheelbase, where)
  for key, (least, most) in _LENGTHS.items():
    if key in vehicle and not least < number(key) / wheelbase < most:
      raise RecordingError(
        f"{where} {key} of {number(key):g} m does not fit a wheelbase of {wheelbase:g} m (cg_to_front + cg_to_rear);"
        " give all lengths in m"
      )
  if {"mass", "yaw_inertia"} <= set(vehicle):
    share = number("yaw_inertia") / (number("mass") * wheelbase**2)
    if not _GYRATION[0] < share < _GYRATION[1]:
      raise RecordingError(
        f"{where} yaw_inertia of {number('yaw_inertia'):g} kg m^2 does not fit {number('mass'):g} kg and a wheelbase of"
        f" {wheelbase:g} m; a usual car has {0.17 * number('mass') * wheelbase**2:.3g} kg m^2"
      )


def check_deviations(vehicle: Mapping[str, float | str], std: Mapping[str, float], where: str) -> None:
  """Raises RecordingError for a size whose deviation is larger than itself."""
  for key in (key for key in SIZES if key in vehicle and key in std):
    figure, deviation = float(vehicle[key]), std[key]
    if deviation <= _WIDEST * figure:
      continue
    unit, scale = _SMALLER.get(key, _MILLIMETRES)
    small = f"; is it in {unit}? write {scale * deviation:.6g}" if scale * deviation <= _WIDEST * figure else ""
    raise RecordingError(
      f"{where} {key} of {deviation:g} is larger than the {figure:g} that [vehicle] says: give one standard deviation, "
      f"in the same unit{small}; leave it out when it is not known"
    )


def _check_supply(vehicle: Mapping[str, float | str], where: str) -> None:
  battery, supply = CHANNELS["battery_voltage"], vehicle.get("supply_voltage")
  if isinstance(supply, float) and supply > battery.limit:
    unit, scale = battery.log_units[0]
    cure = f"is it in {unit}? write {scale * supply:g}" if scale * supply > _CELL else "give the battery's volts"
    raise RecordingError(f"{where} supply_voltage is {supply:g} V, implausible above {battery.limit:g} V; {cure}")


def _check_wheelbase(vehicle: Mapping[str, float | str], where: str, std: Mapping[str, float]) -> None:
  """A wheelbase is stated by its two parts: by itself it would be left out, and the nominal car's stand in."""
  if isinstance(length := vehicle.get("wheelbase"), float):
    half = f"cg_to_front = {0.5 * length:g} and cg_to_rear = {0.5 * length:g}"
    raise RecordingError(f"{where} wheelbase is not read: write its two parts, {half} where they are equal")
  if "wheelbase" in std:
    raise RecordingError(f"{where[:-1]}.std] wheelbase is not read: write the deviations of cg_to_front and cg_to_rear")


def _check_ends(ends: Mapping[str, float], mass: float, where: str) -> None:
  """One of the two lengths in another unit than the other."""
  (low, small), (high, large) = sorted(ends.items(), key=lambda end: end[1])
  if not large > _APART * small > 0.0:
    return
  for scale, unit in ((1e-3, "mm"), (1e-2, "cm")):
    if scale * large < _APART * small and _DENSITY[0] < mass / (scale * large + small) ** 3 < _DENSITY[1]:
      raise RecordingError(
        f"{where} {high} of {large:g} m does not fit {low} of {small:g} m; is it in {unit}? write {scale * large:.6g}"
      )


def _check_mass(mass: float, wheelbase: float, where: str) -> None:
  if _DENSITY[0] < mass / wheelbase**3 < _DENSITY[1]:
    return
  fits = lambda scale, weighs: _DENSITY[0] < weighs * mass / (scale * wheelbase) ** 3 < _DENSITY[1]
  cures = [
    f"is it in {unit}? multiply all lengths by {scale:g}" + ("" if weighs == 1.0 else ", and the mass, in g, by 0.001")
    for scale, unit in ((1e-3, "mm"), (1e-2, "cm"))
    for weighs in (1.0, 1e-3)
    if fits(scale, weighs) and _SHORTEST < scale * wheelbase < _LONGEST
  ]
  if cures:
    said = f"{where} a wheelbase of {wheelbase:g} m (cg_to_front + cg_to_rear) does not fit {mass:g} kg"
    raise RecordingError(f"{said}; {'; or '.join(cures)}")
  grams = _DENSITY[0] < 1e-3 * mass / wheelbase**3 < _DENSITY[1]
  cure = f"is it in g? write {1e-3 * mass:g}" if grams else "give the mass in kg and all lengths in m"
  raise RecordingError(f"{where} mass of {mass:g} kg does not fit a wheelbase of {wheelbase:g} m; {cure}")
