"""The page of a tracking run: indicators, the driven path and the reference, speed, steering and errors."""

from pathlib import Path as File

import numpy as np
from numpy.typing import NDArray

from agents.control.closed_loop import Drive
from agents.control.kpis import Kpis
from qcar_twin.pages import Chart, Explorer, Line, Moment, Panel, Route, Run, Section, Table, line, write_page
from qcar_twin.pages.charts import axis
from qcar_twin.plant import POSITION, STEERING, VELOCITY, VOLTAGE
from qcar_twin.vehicle.drive import Drive as Motor
from qcar_twin.vehicle.vehicle import Vehicle

_AROUND = 1.0  # s shown on either side of the largest error


def write_tracking(folder: File, label: str, drive: Drive, indicators: Kpis, sentence: str, vehicle: Vehicle) -> File:
  """Write report.html; returns its path.

  Args:
    label: controller and version.
    vehicle: that was driven.
    sentence: the indicators in one line.
  """
  parts = [drive_section(drive, vehicle), _errors(label, drive), _indicators(indicators)]
  return write_page(
    folder / "report.html", f"{label} on path {drive.path.name}", f"{sentence}.", parts,
    "Medians over the runs. ME: largest cross-track error; RMSE: its root mean square; IACA: mean absolute steering.",
  )  # fmt: skip


def drive_section(drive: Drive, vehicle: Vehicle) -> Section:
  """Every run: channels next to the map, the moments of the largest errors."""
  runs, moments = [], []
  for car in range(drive.signals.shape[1]):
    name, until = f"run {car + 1}", drive.under_way[:, car]
    runs.append(_run(name, drive, car, until, vehicle.motor))
    worst = float(drive.time[until][int(np.argmax(np.abs(drive.cross_track[until, car])))])
    moments.append(Moment(name, worst - _AROUND, worst + _AROUND, f"{name}: the largest error, at {worst:.1f} s"))
  guides = [(drive.path.x, drive.path.y, "reference")]
  for lane in drive.path.lanes:
    guides += [(np.array([lane.start, lane.end]), np.array([side, side]), "border") for side in (lane.left, lane.right)]
  caption = (
    "One car's drive: estimated and true, commands, errors. The map is coloured by the cross-track error, the reference"
    " dashed; click it to see the channels at that moment."
  )
  return Section("The drive", "", figures=[Explorer(caption, runs, moments, "error [mm]", guides=guides)])


def _run(name: str, drive: Drive, car: int, until: NDArray[np.bool_], motor: Motor) -> Run:
  time, signals, commands = drive.time[until], drive.signals[until, car], drive.commands[until, car]
  one = lambda title, value: Panel(title, [Line("twin", time, value, "true")])
  given = lambda title, value: Panel(title, [Line("note", time, value, "command")])
  error = 1e3 * drive.cross_track[until, car]
  missed = 1e3 * np.hypot(*(drive.pose[until, car, POSITION] - signals[:, POSITION]).T)
  speed, estimated = (np.hypot(*v.T) for v in (signals[:, VELOCITY], drive.velocity[until, car]))
  speeds = Panel("speed [m/s]", [Line("bicycle", time, estimated, "estimated"), Line("twin", time, speed, "true")])
  panels = [
    one("cross-track error [mm]", error),
    one("estimated position off by [mm]", missed),
    speeds,
    given("steering command [°]", np.degrees(commands[:, STEERING])),
    given(f"{motor.channel.replace('_', ' ')} [{motor.unit}]", commands[:, VOLTAGE]),
  ]
  return Run(name, panels, Route(time, signals[:, 0], signals[:, 1], np.abs(error)))


def _errors(label: str, drive: Drive) -> Section:
  traces = []
  for car in range(drive.signals.shape[1]):
    until = drive.under_way[:, car]
    traces.append(line(drive.arc_length[until, car], 1e3 * drive.cross_track[until, car], "twin", f"run {car + 1}",
                       opacity=0.6, hovertemplate="%{x:.2f} m: %{y:.1f} mm"))  # fmt: skip
  layout = {"xaxis": axis("travelled distance [m]"), "yaxis": axis("cross-track error [mm]"), "showlegend": False}
  caption = f"Cross-track error of {label} over the distance, every run."
  return Section("Errors along the path", "", figures=[Chart(caption, traces, layout)])


def _indicators(indicators: Kpis) -> Section:
  rows = [
    (f"run {k + 1}", 1e3 * float(me), 1e3 * float(rmse), float(np.degrees(iaca)))
    for k, (me, rmse, iaca) in enumerate(zip(indicators.me, indicators.rmse, indicators.iaca, strict=True))
  ]
  return Section("Indicators", "", [Table("", ("", "ME [mm]", "RMSE [mm]", "IACA [°]"), rows)])
