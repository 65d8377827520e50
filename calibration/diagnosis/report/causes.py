"""What was left out of the twin, what is still unexplained, and where the missing physics acts."""

from collections.abc import Mapping

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.decision.claims import Claim
from calibration.diagnosis.decision.structure import PROPERTIES
from calibration.diagnosis.holdout_errors import share_taken_off
from calibration.diagnosis.outcome import Diagnosis
from calibration.diagnosis.report import figures, wording
from calibration.diagnosis.report.demonstration import Demonstration
from calibration.diagnosis.report.document import unknown_variables
from calibration.diagnosis.report.errors import judged_on, repaired, worst_left
from calibration.fitting.observations import CHANNELS
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages import Cell, Section, Table
from qcar_twin.pages.page import Figure
from qcar_twin.twin.mechanisms.base import Mechanism


def left_out(d: Diagnosis) -> Section:
  """The claims: name, size with its deviation, probability, and what each takes off the error."""
  title, mechanisms = "What was left out of the twin", claimed(d)
  if not d.decision.claims:
    return Section(title, f"No mechanism is claimed.{_not_claimed(d)}")
  lines = []
  for claim in d.decision.claims:
    name = claim.mechanism
    lines.append(f"* {name}: {wording.happening(mechanisms[name])}. {effect_on_car(d, name)}".rstrip())
  where = judged_on(d)[1]
  taken = f"takes off the error on {where} [%]" if where else "takes off the error [%]"
  columns = ("mechanism", "size ± standard deviation", "probability", taken, "indistinguishable from")
  table = Table(
    "Mechanisms that were added to the twin", columns, [_claim_row(d, c, mechanisms) for c in d.decision.claims]
  )
  text = "\n".join(lines)
  if where:
    text += (
      "\n\nThe error is the squared error above sensor noise of the recalibrated twin. What a mechanism takes off comes"
      " back when it is left out and the others are refitted."
    )
  if not all(claim.certain for claim in d.decision.claims):
    text += (
      "\n\nThe rest has structure without a name. That lowers every probability: of names claimed with such a rest"
      " fewer are right."
    )
  return Section(title, f"{text}{_not_claimed(d)}", [table])


def _claim_row(d: Diagnosis, claim: Claim, mechanisms: Mapping[str, Mechanism]) -> tuple[Cell, ...]:
  taken = share_taken_off(d.replay, judged_on(d)[0], claim.mechanism) if d.replay else None
  size = wording.sizes(claim, mechanisms[claim.mechanism]) or "–"
  others = wording.listed(claim.indistinguishable_from) or "–"
  return claim.mechanism, size, round(claim.probability, 2), None if taken is None else round(100 * taken), others


def _not_claimed(d: Diagnosis) -> str:
  if not d.decision.possible:
    return ""
  why = "too small to matter, perhaps chance, at a bound or shared with another"
  return f"\n\nLikely alone, but not claimed ({why}): {wording.listed(d.decision.possible)}."


def unexplained(d: Diagnosis) -> Section:
  """What the repaired twin still gets wrong, how it behaves, and the moment where it is largest."""
  title, text, tables = "What is still unexplained, and where", "", []
  if not d.decision.nameless:
    text = "The rest shows no more structure than recordings of cars without hidden effects do."
  elif d.decision.leftovers:
    text = "The rest shows more structure than recordings of cars without hidden effects do."
    tables.append(_structure(d))
  else:
    text = "A part of the error has no name in the catalogue."
  if d.decision.undecided:
    text += f" {d.decision.undecided}"
  if d.decision.nameless and d.location.degrees:
    best = next(iter(d.location.degrees))
    text += "\n\nAn unnamed error was tried in every place where one could act, as a smooth function of the motion."
    if d.location.degrees[best] > 0.0:
      text += f" {wording.unknown_words('unknown_' + best).capitalize()} explains most."
      tables.append(_unnamed(d))
    else:
      text += " None explains any of it."
  fits, where = judged_on(d)
  seconds = worst_left(d.replay, fits) if d.replay is not None and fits and repaired(d) else None
  drawn: list[Figure] = []
  if seconds is not None:
    words = RESIDUALS[seconds.channel].words
    caption = (
      f"The {seconds.end - seconds.start:.0f} s of {where} in which the repaired twin errs most: {words} in"
      f" {seconds.recording}, from {seconds.start:.1f} s. There its error is {seconds.size:.2g} times the sensor noise."
    )
    drawn.append(figures.moment(seconds, caption))
  return Section(title, text, tables, drawn)


def _structure(d: Diagnosis) -> Table:
  rows: list[tuple[Cell, ...]] = []
  for i in d.decision.leftovers:
    depends = ", ".join(wording.quantity(name) for name in i.depends_on)
    rows.append((RESIDUALS[i.channel].words, PROPERTIES[i.family], depends, 100 * i.size if i.size else None))
  return Table("Residual structure", ("channel", "property", "follows", "size [% of the channel's spread]"), rows)


def _unnamed(d: Diagnosis) -> Table:
  most = max(*d.location.degrees.values(), 1e-12)
  rows = [(wording.unknown_words("unknown_" + n),
           ", ".join(wording.quantity(v) for v in unknown_variables("unknown_" + n)), round(100 * max(g, 0.0) / most))
          for n, g in d.location.degrees.items()]  # fmt: skip
  return Table("Unnamed errors", ("acts as", "smooth function of", "explains, against the best [%]"), rows)


def where(d: Diagnosis, shown: Demonstration) -> Section:
  """Part of the car, channels, circumstances and seconds; the film, channels and map."""
  place, observations = d.location, d.pool.problem.observations
  noun = figures.SHARED[place.source]
  meaning = {
    "claim": "The improvement of the fit is the drop of the squared error, weighted by the noise of each channel.",
    "unknown": "The improvement of the fit is what the best unnamed error would bring.",
    "residual": "Nothing is claimed. What is shown is where the recalibrated twin errs most.",
  }[place.source]
  shares = [f"{RESIDUALS[name].words} {100 * share:.0f} %" for name, share in place.channels.items() if share > 0.01]
  text = (
    f"{meaning}\n\n"
    + (f"* Part of the car: {place.subsystem}.\n" if place.subsystem != "none" else "")
    + f"* Channels: {', '.join(shares)} of the {noun}.\n"
    + f"* Circumstances: {wording.rule(place.region)} holds {100 * place.region.share:.0f} % of the {noun} in"
    f" {100 * place.region.samples:.0f} % of the driving.\n"
  )
  if shown.no_film:
    text += f"\n\n{shown.no_film}"
  spans = Table(
    f"Seconds that hold most of the {noun}",
    ("recording", "from [s]", "to [s]", "share [%]"),
    [(s.recording, round(s.start, 2), round(s.end, 2), round(100 * s.share, 1)) for s in place.time],
  )
  drawn: list[Figure | None] = [
    shown.clip,
    figures.explorer(d.pool, d.model.residual, place),
    figures.channel_shares(place),
    figures.share_over_time(observations, place),
  ]
  title = "Where the missing physics acts" if place.source != "residual" else "Where the twin errs most"
  return Section(title, text, [spans], [f for f in drawn if f is not None])


def claimed(d: Diagnosis) -> dict[str, Mechanism]:
  """The claimed mechanisms by name."""
  return {c.mechanism: d.pool.problem.mechanism(c.mechanism) for c in d.decision.claims}


def effect_on_car(d: Diagnosis, name: str) -> str:
  """How much a claimed mechanism moves each channel here, after recalibration: "It moves yaw rate by …"."""
  model = d.model
  without = d.pool.models.get(frozenset(model.mechanisms) - {name})
  if without is None or name not in model.mechanisms:
    return ""
  moved = channel_changes(d, model, without)
  top = sorted(moved, key=lambda n: -moved[n][1])[:3]
  sizes = ", ".join(f"{RESIDUALS[n].words} by {moved[n][0]:.2g} {RESIDUALS[n].symbol}" for n in top)
  return f"On the fitted recordings it moves {sizes} (root mean square)."


def channel_changes(d: Diagnosis, one: Candidate, other: Candidate) -> dict[str, tuple[float, float]]:
  """Per channel: RMS difference of two models in the channel's unit, and in nats per value."""
  observations = d.pool.problem.observations
  whitened = one.residual - other.residual
  raw = whitened / d.pool.problem.whiten(np.ones(len(observations)))
  out = {}
  for index in np.unique(observations.channel):
    rows = observations.channel == index
    out[CHANNELS[index]] = (float(np.sqrt(np.mean(raw[rows] ** 2))), float(np.mean(whitened[rows] ** 2)))
  return out
