"""The charts of a diagnosis: channels and map, evidence, errors before and after."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.locate import Location
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.search.decide import Decision
from calibration.fitting.observations import Observations
from calibration.fitting.residual_channels import RESIDUALS
from calibration.shown_runs import runs_of
from qcar_twin.pages import Chart, Explorer, Moment, bars, line, ranked

Array = NDArray[np.float64]

LABELS = {"before": "twin before", "twin": "twin repaired", "nominal": "nominal"}
_RIVALS = 4  # shown even where they explain nothing
_POINTS = 3000  # of the line of evidence


def explorer(pool: Pool, after: Array, location: Location) -> Explorer:
  """Channels of every recording, measured, before and after, beside the map of evidence.

  Args:
    pool: its base is "before".
    after: whitened residual of the repaired twin, (M,), with the pool's weights; the base's own without a repair.
    location: evidence, channels, and the seconds to step through.
  """
  observations = pool.problem.observations
  factor = pool.problem.whiten(np.ones(len(observations)))
  predicted = {"before": observations.measured + pool.base.residual / factor}
  if after is not pool.base.residual:
    predicted["twin"] = observations.measured + after / factor
  shaded: dict[str, list[tuple[float, float]]] = {}
  for span in location.time:
    shaded.setdefault(span.recording, []).append((span.start, span.end))
  channels = [name for name in location.channels if name in observations.present]
  runs = runs_of(observations, predicted, LABELS, pool.floor, channels, location.evidence, shaded)
  moments = [Moment(s.recording, s.start, s.end, f"{s.recording}, {s.start:.1f} to {s.end:.1f} s,"
                    f" {100 * s.share:.0f} % of the evidence") for s in location.time]  # fmt: skip
  first = {m.run: k for k, m in reversed(list(enumerate(moments)))}
  runs.sort(key=lambda run: first.get(run.name, len(moments)))  # the page opens with the worst
  mapped = " Click the map to see the channels at that moment." if any(r.route for r in runs) else ""
  caption = (
    "What was measured, and what the twin makes of the same commands. Shaded: the seconds that carry the evidence;"
    " about zero of the errors: the sensor's noise. Lines break where the simulation starts anew from the measurement."
    f"{mapped}"
  )
  return Explorer(caption, runs, moments, level="evidence [nats/s]", shade="seconds that carry the evidence")


def channel_shares(location: Location) -> Chart | None:
  """How the evidence is spread over the channels."""
  rows = [(RESIDUALS[n].words, 100.0 * s, "twin", False) for n, s in location.channels.items() if s >= 0.005]
  return ranked("Where it shows: share of the evidence by channel.", rows, "share [%]") if rows else None


def evidence_over_time(observations: Observations, location: Location) -> Chart:
  """Cumulative evidence through all recordings in order: it climbs where the mismatch acts."""
  order = np.lexsort((observations.time, observations.recording))
  recording = observations.recording[order]
  total = np.cumsum(location.evidence[order])
  clock = _driving_time(observations.time[order], recording)
  edges = np.concatenate([[0], np.flatnonzero(np.diff(recording)) + 1])
  keep = np.unique(np.concatenate([np.linspace(0, len(order) - 1, _POINTS).astype(int), edges]))
  names = [observations.names[r] for r in recording[keep]]
  trace = line(clock[keep], total[keep], "twin", "evidence", text=names, hovertemplate="%{text}: %{y:.0f} nats")
  shapes = [{"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": float(clock[e]), "x1": float(clock[e]),
             "layer": "below", "line": {"color": "@rule", "width": 1}} for e in edges]  # fmt: skip
  layout = {
    "xaxis": {"title": {"text": "driving time, all recordings in a row [s]"}},
    "yaxis": {"title": {"text": "evidence so far [nats]"}},
    "shapes": shapes,
    "showlegend": False,
  }
  caption = "Evidence through the recordings: it climbs where the twin is wrong. Thin lines: a recording begins."
  return Chart(caption, [trace], layout, 300)


def ranked_evidence(decision: Decision, most: int = 14) -> Chart:
  """Bars of evidence, best first; claims in the twin's colour, what can't be told from them hatched."""
  claimed = {c.mechanism for c in decision.claims}
  equal = {name for c in decision.claims for name in c.equivalent_to}
  shown = [row for k, row in enumerate(decision.ranking[:most]) if row[1] > 0.0 or k < _RIVALS]
  rows = [(name, nats, "twin" if name in claimed else "nominal", name in equal) for name, nats in shown]
  caption = "Evidence for each mechanism when it is added alone, best first. Hatched: not to be told from a claim."
  return ranked(caption, rows, "evidence [nats]")


def before_and_after(fits: Mapping[str, ChannelFit], kept: str) -> Chart | None:
  """RMS error per channel before and after, in multiples of the sensor's own noise."""
  names = [n for n, f in fits.items() if np.isfinite([f.before, f.after]).all()]
  if not names:
    return None
  unit = {n: fits[n].noise_floor or max(fits[n].before, 1e-12) for n in names}
  before, after = ([getattr(fits[n], key) / unit[n] for n in names] for key in ("before", "after"))
  low, high = ([fits[n].before * (1.0 + fits[n].ci95[k]) / unit[n] for n in names] for k in range(2))
  return bars(
    f"Errors on {kept} in multiples of the sensor's own noise, with 95 % bounds.",
    [RESIDUALS[n].words for n in names],
    {"before": before, "twin": after},
    "error / sensor noise",
    {"twin": (low, high)},
    (1.0, "sensor noise"),
    LABELS,
  )


def _driving_time(time: Array, recording: NDArray[np.int64]) -> Array:
  """Recording times put one behind the other, s."""
  clock, spent = np.empty(len(time)), 0.0
  for number in dict.fromkeys(recording.tolist()):
    rows = recording == number
    clock[rows] = spent + time[rows] - time[rows].min()
    spent += float(np.ptp(time[rows]))
  return clock
