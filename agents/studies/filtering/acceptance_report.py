"""The sections of the results on what the online filter gets through: validity, honesty, accusations, car by car."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from agents.studies.filtering.acceptance_study import (
  CASES,
  LIMIT,
  Case,
  Driven,
  Outcome,
  Subject,
  judge,
  limit_drive,
  lock_drive,
  weave_drive,
)
from qcar_twin import markdown
from qcar_twin.estimation.settings import ESTIMATED, FilterSettings

HEADS = ("case", "car", "valid", "beyond while valid", "NEES", "position, worst", "yaw, worst", "false alarms")
SHORT = ("case", "valid", "beyond while valid", "NEES", "NEES, plain filter", "position, worst", "false alarms")
MORE = ("filter", "cars", "limit", "valid", "beyond, mean", "beyond, worst car", "position, worst", "false alarms")
Drives = dict[str, Driven]  # by what is done
Judged = dict[tuple[str, str], tuple[Outcome, Case]]


def drives_of(subject: Subject) -> Drives:
  """What a subject is judged by."""
  return {"limit": limit_drive(subject), "lock": lock_drive(subject), "weave": weave_drive(subject)}


def judged(subjects: Sequence[Subject], drives: Mapping[str, Drives], quick: bool = False) -> Judged:
  """Every case on every car, by names; the limit of grip and sound sensors alone when `quick`.

  Args:
    drives: by the subject's name.
  """
  done: Judged = {}
  for subject in subjects:
    driven, sound = drives[subject.name], Case()
    limit = judge(subject, driven["limit"], sound)
    for title, sign in (("limit, forward", 1.0), ("limit, reverse", -1.0)):
      done[title, subject.name] = limit.of(LIMIT[:, 0] * sign > 0.0), sound
    done["full lock", subject.name] = judge(subject, driven["lock"], sound), sound
    for name, case in list(CASES.items())[: 1 if quick else None]:
      done[name, subject.name] = judge(subject, driven["weave"], case), case
  order = list(dict.fromkeys(case for case, _ in done))
  return dict(sorted(done.items(), key=lambda item: order.index(item[0][0])))


def acceptance_sections(subjects: Sequence[Subject], quick: bool = False) -> list[str]:
  """The plain filter car by car, and the worst of the cars for the filter that estimates unknown numbers."""
  drives = {subject.name: drives_of(subject) for subject in subjects}
  plain = judged(subjects, drives, quick)
  learning = [dataclasses.replace(s, settings=s.settings.estimating(*ESTIMATED)) for s in subjects]
  return [
    "## What the filter gets through",
    "",
    "The online filter with its watches on cars that are driven open loop, 8 or 20 s. At the limit there are 2"
    " s of full throttle. A step steer of 0.3 rad follows, either way, at 3 and 4 V. At full lock wheels go from"
    " stop to stop, 0.5 rad, twice a second, at some 0.7 m/s. Otherwise one car weaves forward and one in reverse"
    " at 0.3 to 0.7 m/s. What the case names happens from 6 s on. The first and the"
    " second car are the independent ones of the concealed sessions. Their filter has the vehicle table as"
    " measured and nominal drive and tyres. Valid is the share of all periods. Beyond is the share of the valid"
    " ones in which position or yaw is beyond its bound. Each bound is stated with a risk of"
    f" {FilterSettings().risk:g}. NEES of the position is a median, 1.4 for a consistent filter. Worst errors"
    " are those of valid periods. A false alarm is a warning that names a sound sensor.",
    "",
    *markdown.table(HEADS, [(case, car, *_cells(*one)) for (case, car), one in plain.items()]),
    "",
    "## With unknown numbers as states",
    "",
    f"The same drives and readings; EKF_BM also estimates {', '.join(ESTIMATED)}. The worst car in each column.",
    "",
    *markdown.table(SHORT, _worst(judged(learning, drives, quick), plain)),
  ]


def limit_section(subjects: Sequence[Subject]) -> list[str]:
  """The limit of grip on many cars: their filter, plain and with unknown numbers, kind by kind."""
  outcomes_of: dict[tuple[str, str, str], list[Outcome]] = {}
  for subject in subjects:
    driven = limit_drive(subject)
    for name, settings in (("plain", subject.settings), ("states", subject.settings.estimating(*ESTIMATED))):
      outcome = judge(dataclasses.replace(subject, settings=settings), driven, Case())
      for title, sign in (("forward", 1.0), ("reverse", -1.0)):
        outcomes_of.setdefault((name, subject.name, title), []).append(outcome.of(LIMIT[:, 0] * sign > 0.0))
  rows = []
  for (name, kind, title), outcomes in sorted(outcomes_of.items()):
    beyond = [100.0 * one.beyond for one in outcomes]
    worst, false = max(np.nanmax(one.position) for one in outcomes), sum(one.falsely(Case()) for one in outcomes)
    valid = 100.0 * np.mean([one.valid.mean() for one in outcomes])
    cells = f"{valid:.1f} %", f"{np.mean(beyond):.2f} %", f"{max(beyond):.2f} %", f"{1e3 * worst:.0f} mm"
    rows.append((name, f"{len(outcomes)} of the {kind}", title, *cells, f"{false} of {3 * len(outcomes)}"))
  return [
    "## The limit of grip on more cars",
    "",
    "The same drives at the limit on further cars, three runs in each direction on each.",
    "",
    *markdown.table(MORE, rows),
  ]


def _worst(learnt: Judged, plain: Judged) -> list[tuple[str, ...]]:
  rows = []
  for name in dict.fromkeys(case for case, _ in learnt):
    ones = [one for (case, _), one in learnt.items() if case == name]
    before = [one for (case, _), (one, _) in plain.items() if case == name]
    outcomes, case = [one for one, _ in ones], ones[0][1]
    cars = sum(one.valid.shape[1] for one in outcomes)
    rows.append(
      (
        name,
        f"{100 * min(one.valid.mean() for one in outcomes):.1f} %",
        f"{100 * max(one.beyond for one in outcomes):.2f} %",
        f"{max(np.nanmedian(one.nees) for one in outcomes):.1f}",
        f"{max(np.nanmedian(one.nees) for one in before):.1f}",
        f"{1e3 * max(np.nanmax(one.position) for one in outcomes):.0f} mm",
        f"{sum(one.falsely(case) for one in outcomes)} of {cars}",
      )
    )
  return rows


def _cells(outcome: Outcome, case: Case) -> tuple[str, ...]:
  return (
    f"{100 * outcome.valid.mean():.1f} %",
    f"{100 * outcome.beyond:.2f} %",
    f"{np.nanmedian(outcome.nees):.1f}",
    f"{1e3 * np.nanmax(outcome.position):.0f} mm",
    f"{1e3 * np.abs(outcome.yaw[outcome.valid]).max():.0f} mrad",
    f"{outcome.falsely(case)} of {outcome.valid.shape[1]}",
  )
