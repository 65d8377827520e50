"""A NumPy module, and a CasADi function in it, of the single track with the twin's named effects: for MPC."""

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path

from calibration.exports import single_track
from calibration.exports.cars import CarModel
from calibration.exports.numbers import EXPRESSED, MATCHED, Numbers, matched, single_track_numbers, stays
from calibration.exports.target import Job, Target
from calibration.exports.written import UNITS, gain_unit, heading, origin, text_lines
from qcar_twin.twin.mechanisms.base import Mechanism


def _expresses(mechanism: Mechanism) -> bool:
  return mechanism.name in EXPRESSED or stays(mechanism)


def _write(job: Job, path: Path) -> Sequence[str]:
  car = single_track_numbers(job.twin, job.theta, job.kept(TARGET))
  recordings = [r for r in job.dataset.recordings if r.role == "identify"] if job.dataset else []
  factors: dict[str, float] = {}
  if recordings:
    kept = job.kept(TARGET)
    car, factors = matched(job.twin, job.theta, kept, single_track, car, MATCHED, recordings, job.command_shift)
  text = Path(single_track.__file__).read_text(encoding="utf-8")
  lines = [*heading(job, job.lost(TARGET)), text.rstrip(), "", "", *_numbers(job, car, factors)]
  text_lines(path, lines)
  said = ["states: " + ", ".join(single_track.state_names(car))]
  if not recordings:
    said.append("numbers are the twin's as they are; give --dataset to match them to what the twin does")
  return said


def _numbers(job: Job, car: Numbers, factors: Mapping[str, float]) -> list[str]:
  units = (
    UNITS | {"drive_gain": gain_unit(job.twin.vehicle)} | {p.name: p.unit for m in job.present for p in m.parameters}
  )
  lines = ["CAR = {"]
  for name, value in car.items():
    lines.append(f'  "{name}": {value!r},  # {units.get(name, "per period")}; {origin(name, factors)}')
  return [*lines, "}"]


def _drives(path: Path, job: Job) -> tuple[CarModel, Mapping[str, object]]:
  spec = importlib.util.spec_from_file_location("exported_single_track", path)
  assert spec is not None and spec.loader is not None
  module = importlib.util.module_from_spec(spec)
  spec.loader.exec_module(module)
  return module, module.CAR  # type: ignore[return-value]


TARGET = Target(
  name="single-track",
  file="single_track.py",
  summary="NumPy module with a CasADi function, for model predictive control",
  write=_write,
  expresses=_expresses,
  drives=_drives,
  structure={},
)
