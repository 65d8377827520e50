"""Session designs: the manoeuvres of a laboratory session, of a compact one for large campaigns, of the paper's."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial

import numpy as np

from qcar_twin.recordings.recording import nearest

from . import manoeuvres as m
from .manoeuvres import Manoeuvre

VOLTS = {"identify": (0.75, 1.25, 1.5, 2.0, 2.5), "validate": (1.1, 1.35, 1.85, 2.25)}  # V
DEGREES = {"identify": (4.0, 7.0, 9.0, 11.0, 14.0), "validate": (5.5, 8.5, 10.5, 12.5, 13.5)}  # deg


def paper(rng: np.random.Generator) -> list[Manoeuvre]:
  """The paper's voltage steps, step steers, ramp steer and oval."""
  steps = [m.voltage_step(volts, role) for role, levels in VOLTS.items() for volts in levels]
  steers = [m.steering_step(degrees, role) for role, levels in DEGREES.items() for degrees in levels]
  return [*steps, *steers, m.ramp_steer(), m.oval(1.0, 12.0, "holdout")]


def lab(rng: np.random.Generator) -> list[Manoeuvre]:
  """About 30 recordings, 4 to 5 minutes: the paper's steps and what separates the effects of the catalogue."""
  steps = [m.voltage_step(volts, role) for role, levels in VOLTS.items() for volts in levels]
  steers = [m.steering_step(degrees, role) for role, levels in DEGREES.items() for degrees in levels]
  return [
    m.standstill(4.0),
    *steps,
    m.coast_downs(12.0),
    m.drive_brake(rng, 12.0),
    m.excitation(rng, 14.0, "identify", "excitation_a"),
    m.throttle_in_turn(13.2),
    *steers,
    m.ramp_steer(12.0),
    m.ramp_steer(10.0, 2.2, 22.0, "identify", "ramp_steer_fast"),
    m.circles(0.4, 22.0, 14.0, "identify", "circles_slow"),
    m.circles(1.6, 12.0, 12.0, "identify", "circles_fast"),
    m.chirp(0.6, 13.0, "identify", "chirp_slow"),
    m.chirp(1.6, 13.0, "identify", "chirp_fast"),
    m.excitation(rng, 14.0, "validate", "excitation_b", reverse=False),
    m.oval(1.0, 13.0, "validate"),
    m.figure_eight(0.9, 13.0, "validate"),
    m.free_drive(rng, 14.0, "holdout", "free_drive_a"),
    m.free_drive(rng, 14.0, "holdout", "free_drive_b", quickest=1.4),
  ]


def compact(rng: np.random.Generator) -> list[Manoeuvre]:
  """15 recordings, about two minutes, the same phenomena."""
  return [
    m.standstill(3.0),
    m.staircase((0.75, 1.5, 2.5), 8.5, "identify", "voltage_steps"),
    m.staircase((1.1, 2.25), 6.5, "validate", "voltage_steps_other"),
    m.coast_downs(9.0),
    m.drive_brake(rng, 9.0),
    m.excitation(rng, 9.5, "identify", "excitation"),
    m.ramp_steer(9.0, 2.2, 22.0, "identify", "ramp_steer_fast"),
    m.circles(0.4, 22.0, 9.0, "identify", "circles_slow"),
    m.circles(1.5, 10.0, 9.0, "identify", "circles_fast"),
    m.chirp(0.6, 9.5, "identify", "chirp_slow"),
    m.chirp(1.6, 9.5, "identify", "chirp_fast"),
    m.throttle_in_turn(8.8),
    m.oval(1.0, 9.5, "validate"),
    m.figure_eight(0.9, 9.5, "holdout"),
    m.free_drive(rng, 9.5, "holdout", "free_drive"),
  ]


LEVELS = {"duty": ((0.07, 0.13, 0.2), (0.1, 0.17)), "speed": ((0.7, 1.4, 2.2), (1.0, 1.8))}
CURRENTS = ((7.0, 10.0, -6.0, 12.0), (9.0, 6.0, -7.0))  # A
TURNS = ((6.0, "identify"), (10.0, "identify"), (8.0, "validate"))  # deg


def vesc(command: str, rng: np.random.Generator) -> list[Manoeuvre]:
  """Twelve recordings, about 43 s, of a car with a VESC that is commanded a duty, a current or a speed."""
  if command == "current":
    own = [m.pulses(CURRENTS[0], 6.0, "identify", "pulses"), m.pulses(CURRENTS[1], 4.0, "validate", "pulses_other")]
  else:
    steps, longer = f"{command}_step", 2.0 if command == "duty" else 1.0  # a duty's steps settle in half a second
    own = [
      m.staircase(LEVELS[command][0], 5.0 * longer, "identify", f"{steps}s", steps),
      m.staircase(LEVELS[command][1], 3.5 * longer, "validate", f"{steps}s_other", steps),
    ]
  return [
    m.standstill(1.5),
    *own,
    m.speed_changes(rng, 5.0, "identify", "speed_changes"),
    *(m.steering_step(degrees, role, 2.5) for degrees, role in TURNS),
    m.circles(0.8, 20.0, 4.0, "identify", "circles_slow"),  # wide angles, or nothing shows the linkage
    m.circles(1.8, 10.0, 4.0, "identify", "circles_fast"),
    m.chirp(1.4, 3.5, "identify", "chirp"),
    m.free_drive(rng, 5.0, "validate", "free_drive_a"),
    m.oval(1.2, 4.0, "holdout"),
  ]


DESIGNS: dict[str, Callable[[np.random.Generator], list[Manoeuvre]]] = {
  "lab": lab,
  "compact": compact,
  "paper": paper,
  "wild": compact,
  **{f"vesc_{command}": partial(vesc, command) for command in ("duty", "current", "speed")},
}


def plan(design: str, rng: np.random.Generator) -> list[Manoeuvre]:
  """The manoeuvres of a design in order; the second half is driven after a pause. KeyError lists the valid names."""
  if design not in DESIGNS:
    raise KeyError(f"no session design '{design}'{nearest(design, DESIGNS)}")
  return in_two_halves(DESIGNS[design](rng))


def in_two_halves(runs: list[Manoeuvre]) -> list[Manoeuvre]:
  """The same runs, the first half of them in the morning and the others in the afternoon."""
  half = (len(runs) + 1) // 2
  return [dataclasses.replace(run, session="morning" if i < half else "afternoon") for i, run in enumerate(runs)]
