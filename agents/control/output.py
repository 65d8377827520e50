"""What a tracking run leaves behind: kpis.json, traces.csv, report.html."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from agents.control.closed_loop import Drive
from agents.control.kpis import Kpis
from agents.control.page import write_tracking
from qcar_twin.atomic_io import write_json, write_text
from qcar_twin.plant import SIGNALS
from qcar_twin.vehicle.vehicle import QCAR, Vehicle


def write_drive(
  folder: Path, label: str, drive: Drive, indicators: Kpis, config: Mapping[str, object], vehicle: Vehicle = QCAR
) -> str:
  """Write a drive into a folder; returns the indicators in one line.

  Args:
    label: controller and version.
    config: what was asked for; kept with the indicators.
    vehicle: that was driven; its drive says what was commanded.
  """
  folder.mkdir(parents=True, exist_ok=True)
  rows = {f.name: np.asarray(getattr(indicators, f.name)) for f in dataclasses.fields(indicators)}
  write_json(folder / "kpis.json", {"config": config, "kpis": rows})
  write_traces(folder / "traces.csv", drive, vehicle)
  line = indicator_line(label, drive, indicators)
  write_tracking(folder, label, drive, indicators, line, vehicle)
  return line


def write_traces(file: Path, drive: Drive, vehicle: Vehicle = QCAR, car: int = 0) -> None:
  """One car's true signals, commands, estimated pose and cross-track error as columns, SI units."""
  columns = np.column_stack(
    [drive.time, drive.signals[:, car], drive.commands[:, car], drive.pose[:, car], drive.cross_track[:, car]]
  )
  names = ("time", *SIGNALS, *vehicle.commands, "estimated_x", "estimated_y", "estimated_yaw", "cross_track_error")
  lines = [",".join(names), *(",".join(f"{x:.6g}" for x in row) for row in columns)]
  write_text(file, "\n".join(lines) + "\n")


def indicator_line(label: str, drive: Drive, indicators: Kpis) -> str:
  """Medians over the runs, in words, and how many did not come to the path's end."""
  me, rmse, iaca = (float(np.median(x)) for x in (indicators.me, indicators.rmse, indicators.iaca))
  said = [f"ME {1e3 * me:.1f} mm, RMSE {1e3 * rmse:.1f} mm, IACA {np.degrees(iaca):.2f} deg"] if np.isfinite(me) else []
  if not drive.finished.all():
    lost = ~drive.finished
    driven = float(np.where(drive.under_way, drive.arc_length, 0.0).max(axis=0)[lost].min())
    said += [f"{lost.sum()} of {lost.size} runs did not reach the end, the first came {driven:.1f} m far"]
  line = f"{label} on {drive.path.name}: {'; '.join(said)}"
  if drive.path.lanes:
    line += f", {int(indicators.inside.sum())} of {len(indicators.inside)} runs between the borders"
  return line
