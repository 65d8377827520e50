"""The first section of a diagnosis's page: how far twin and recordings are apart, before and after the repair."""

from collections.abc import Mapping

import numpy as np

from calibration.diagnosis.decision.levels import usual_levels
from calibration.diagnosis.holdout_errors import ChannelFit, Replay, recovered_share
from calibration.diagnosis.outcome import Diagnosis
from calibration.diagnosis.report import figures
from calibration.diagnosis.report.moments import Seconds, largest
from calibration.diagnosis.report.wording import listed
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages import Cell, Section, Table
from qcar_twin.pages.page import Figure

Fits = Mapping[str, ChannelFit]
Roles = Mapping[str, Fits]
NO_CURVES: Roles = {}
ROLES = {"holdout": "Held-out recordings, opened at the end", "validate": "Validation recordings"}
TITLE = "Errors before and after"
_HUNDREDFOLD = 100.0  # of the noise, a choice of words: no decision hangs on it


def judged_on(d: Diagnosis) -> tuple[Mapping[str, ChannelFit], str]:
  """The errors that count and the recordings they are of: held-out ones, else those for validation, else none."""
  if d.holdout:
    return d.holdout, "held-out recordings"
  return d.validate, "validation recordings" if d.validate else ""


def parting(d: Diagnosis) -> Seconds | None:
  """The moment in which the two twins part most; without a repair, where the twin errs most."""
  fits, _ = judged_on(d)
  if d.replay is None or not fits:
    return None
  return largest(d.replay, fits, d.replay.after - d.replay.before if repaired(d) else d.replay.before)


def repaired(d: Diagnosis) -> bool:
  """Whether a mechanism was added to the twin."""
  return bool(d.decision.mechanisms)


def errors(d: Diagnosis, curved: Roles = NO_CURVES) -> Section:
  """How good it is: a sentence, the moment where the twins part most, all channels, the tables.

  Args:
    curved: errors of the twin with free curves, by role and channel, where there is one.
  """
  fits, where = judged_on(d)
  if not fits:
    return Section(TITLE, "There are no held-out and no validation recordings, so no error can be shown.")
  text = f"{how_good(d)}\n\n{_meaning(d)}"
  seconds = parting(d)
  drawn: list[Figure | None] = [
    figures.moment(seconds, _parts_here(seconds, where, repaired(d)), repaired(d)) if seconds else None,
    figures.before_and_after(fits, where, repaired(d)),
  ]
  tables = [
    error_table(caption, getattr(d, role), curved.get(role)) for role, caption in ROLES.items() if getattr(d, role)
  ]
  return Section(TITLE, text, tables, [f for f in drawn if f is not None])


def how_good(d: Diagnosis) -> str:
  """What the repair removes in per cent, and how far the twin errs."""
  fits, where = judged_on(d)
  gone, share = "", recovered_share(fits)
  if repaired(d) and share > 0.0:
    gone = f"On {where} the repair removes {100 * share:.0f} % of the squared error above sensor noise. "
  elif repaired(d):
    gone = f"The repair does not lower the error on {where}. "
  return f"{gone}{how_good_in_short(d)}".rstrip()


def how_good_in_short(d: Diagnosis) -> str:
  """ "On held-out recordings the repaired twin errs by 1.0 to 3.0 times the sensor noise, most in motor speed (…)."."""
  fits, where = judged_on(d)
  known = _sizes(fits)
  if not known:
    return ""
  worst = max(known, key=lambda name: known[name])
  most = f"{RESIDUALS[worst].words} ({fits[worst].after:.3g} {RESIDUALS[worst].symbol})"
  whose = "repaired" if repaired(d) else "recalibrated"
  return f"On {where} the {whose} twin errs by {multiples(fits)}, most in {most}."


def short_of(d: Diagnosis) -> str:
  """ "motor speed errs by 3.0 and yaw rate by 1.4 times the sensor noise": beyond what sensors leave; "" for none."""
  sizes = _sizes(judged_on(d)[0])
  beyond = sorted((n for n, size in sizes.items() if size > usual_levels().good), key=lambda n: -sizes[n])
  said = [f"{RESIDUALS[n].words} by {_told(sizes[n])}" for n in beyond]
  return f"{listed(said)} times the sensor noise".replace(" by ", " errs by ", 1) if said else ""


def multiples(fits: Mapping[str, ChannelFit]) -> str:
  """ "1.0 to 3.0 times the sensor noise": smallest and largest over the channels, after the repair."""
  sizes = sorted(_sizes(fits).values())
  if not sizes:
    return "of unknown size against the sensor noise"
  low, high = _told(sizes[0]), _told(sizes[-1])
  return f"{low} times the sensor noise" if low == high else f"{low} to {high} times the sensor noise"


def _told(multiple: float) -> str:
  """ "3.0"; beyond a hundredfold the digits say nothing of the twin: motion capture's noise is 0.1 mm."""
  return f"{multiple:.1f}" if multiple < _HUNDREDFOLD else f"more than {_HUNDREDFOLD:.0f}"


def error_table(caption: str, fits: Fits, curved: Fits | None = None) -> Table:
  """Root mean square errors by channel before and after, against the sensor noise, and the change with its interval."""
  rows: list[tuple[Cell, ...]] = []
  for name, f in fits.items():
    more: tuple[Cell, ...] = (curved[name].after if name in curved else None,) if curved else ()
    change = 100 * (f.after / f.before - 1.0) if f.before else 0.0
    interval = (
      f"{100 * f.ci95[0]:+.1f} to {100 * f.ci95[1]:+.1f}".replace("-", "−") if np.isfinite(f.ci95).all() else None
    )
    rows.append((RESIDUALS[name].axis, f.before, f.after, *more, f.noise, _size(f), round(change, 1), interval))
  extra = ("with curves",) if curved else ()
  columns = ("channel", "before", "after", *extra, "sensor noise", "after / noise", "change [%]", "95 % interval [%]")
  return Table(caption, columns, rows)


def error_lines(d: Diagnosis, curved: Roles = NO_CURVES) -> list[str]:
  """The same table for a terminal, of the recordings that count most: a line a channel."""
  role = "holdout" if d.holdout else "validate"
  fits, own = getattr(d, role), curved.get(role)
  if not fits:
    return []
  titles = ["recalibrated", *(["repaired"] if repaired(d) else []), *(["with curves"] if own else []), "sensor noise"]
  whose = "repaired" if repaired(d) else "recalibrated"
  lines = [f"errors on {judged_on(d)[1]}: {', '.join(titles)} ({whose} over it)"]
  for name, f in fits.items():
    values = [
      f.before,
      *([f.after] if repaired(d) else []),
      *([own[name].after] if own and name in own else []),
      f.noise,
    ]
    lines.append(f"  {RESIDUALS[name].axis}: {', '.join(f'{value:.3g}' for value in values)} ({_size(f):.1f})")
  return lines


def _size(fit: ChannelFit) -> float:
  return fit.after / fit.noise if fit.noise > 0.0 else float("nan")


def _sizes(fits: Fits) -> dict[str, float]:
  """Errors after the repair in multiples of the sensor noise, by channel whose noise is known."""
  return {name: size for name, fit in fits.items() if np.isfinite(size := _size(fit))}


def _meaning(d: Diagnosis) -> str:
  twins = "Before is the recalibrated twin, never an uncalibrated one. After is the repaired twin."
  if not repaired(d):
    twins = "No mechanism was added, so before and after are one twin: the recalibrated one."
  weighed = " In the per cent above, all channels weigh the same." if repaired(d) else ""
  return (
    f"{twins} An error is the root mean square of predicted minus measured values. Sensor noise is what the sensor"
    f" makes at standstill or while driving, whichever is more.{weighed}"
  )


def _parts_here(seconds: Seconds, where: str, has_repair: bool) -> str:
  what = "the two twins part most" if has_repair else "the twin errs most"
  words = RESIDUALS[seconds.channel].words
  return (
    f"The {seconds.end - seconds.start:.0f} s of {where} in which {what}: {words} in {seconds.recording}, from"
    f" {seconds.start:.1f} s. There the {'difference' if has_repair else 'error'} is {seconds.size:.2g} times the"
    " sensor noise. Below: errors, with the sensor noise shaded."
  )


def worst_left(replay: Replay, fits: Mapping[str, ChannelFit]) -> Seconds | None:
  """The moment in which the repaired twin errs most."""
  return largest(replay, fits, replay.after)
