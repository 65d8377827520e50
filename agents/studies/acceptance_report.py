"""The section of the results on what the online filter gets through: validity, honesty and accusations, car by car."""

from collections.abc import Sequence

import numpy as np

from agents.studies.acceptance_study import CASES, LIMIT, Case, Outcome, Subject, judge, limit_drive, weave_drive
from qcar_twin import markdown
from qcar_twin.estimation.settings import FilterSettings

HEADS = ("case", "car", "valid", "beyond while valid", "NEES", "position, worst", "yaw, worst", "falsely accused")


def acceptance_section(subjects: Sequence[Subject], quick: bool = False) -> list[str]:
  """Every case on every car; the limit of grip and sound sensors alone when `quick`."""
  rows = []
  for subject in subjects:
    sound, limit = Case(), judge(subject, limit_drive(subject), Case())
    for title, sign in (("limit, forward", 1.0), ("limit, reverse", -1.0)):
      rows.append((title, subject.name, *_cells(limit.of(LIMIT[:, 0] * sign > 0.0), sound)))
    weave = weave_drive(subject)
    for name, case in list(CASES.items())[: 1 if quick else None]:
      rows.append((name, subject.name, *_cells(judge(subject, weave, case), case)))
  order = list(dict.fromkeys(row[0] for row in rows))
  rows.sort(key=lambda row: order.index(row[0]))
  return [
    "## What the filter gets through",
    "",
    "The online filter with its watches on cars that are driven open loop, 8 or 20 s. At the limit there are 2"
    " s of full throttle. A step steer of 0.3 rad follows, either way, at 3 and 4 V. Otherwise one car weaves"
    " forward and one in reverse at 0.3 to 0.7 m/s. What the case names happens from 6 s on. The first and the"
    " second car are the independent ones of the concealed sessions. Their filter has the vehicle table as"
    " measured and nominal drive and tyres. Valid is the share of all periods. Beyond is the share of the valid"
    " ones in which position or yaw is beyond its bound. Each bound is stated with a risk of"
    f" {FilterSettings().risk:g}. NEES of the position is a median, 1.4 for a consistent filter. Worst errors"
    " are those of valid periods. A sensor is falsely accused where a warning names it and it is sound.",
    "",
    *markdown.table(HEADS, rows),
  ]


def _cells(outcome: Outcome, case: Case) -> tuple[str, ...]:
  return (
    f"{100 * outcome.valid.mean():.1f} %",
    f"{100 * outcome.beyond:.2f} %",
    f"{np.nanmedian(outcome.nees):.1f}",
    f"{1e3 * np.nanmax(outcome.position):.0f} mm",
    f"{1e3 * np.abs(outcome.yaw[outcome.valid]).max():.0f} mrad",
    f"{outcome.falsely(case)} of {outcome.valid.shape[1]}",
  )
