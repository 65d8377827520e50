"""The charts of a diagnosis: errors before and after, channels and map, where the physics acts, evidence."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.locate import Location
from calibration.diagnosis.pool import Pool
from calibration.diagnosis.report.moments import Seconds
from calibration.fitting.observations import Observations
from calibration.fitting.residual_channels import RESIDUALS
from calibration.shown_runs import runs_of
from qcar_twin.pages import Chart, Explorer, Moment, bars, line, ranked
from qcar_twin.pages.charts import axis

Array = NDArray[np.float64]

LABELS = {"before": "recalibrated twin", "twin": "repaired twin", "nominal": "nominal car"}
SHARED = {  # what is shared out over seconds and channels, by the source of a location
  "claim": "improvement of the fit",
  "unknown": "improvement of the fit",
  "residual": "squared error above noise",
}
_ALWAYS, _MOST = 4, 14  # names that are shown even where they explain nothing, and at most
_POINTS = 3000  # of the line of evidence


def moment(seconds: Seconds, caption: str, repaired: bool = True) -> Chart:
  """Some seconds of one channel as measured and predicted, above the errors with the sensor noise shaded."""
  channel = RESIDUALS[seconds.channel]
  twins = {"before": seconds.before, "twin": seconds.after} if repaired else {"before": seconds.before}
  traces = [line(seconds.time, seconds.measured, "measured", style={"width": 2.2})]
  for who, value in twins.items():
    own = {"style": {"width": 2.2}, "hovertemplate": "%{x:.2f} s: %{y:.4g}"}
    traces.append(line(seconds.time, value, who, LABELS[who], **own))
    traces.append(line(seconds.time, value - seconds.measured, who, LABELS[who], yaxis="y2", showlegend=False, **own))
  band = {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "yref": "y2", "y0": -seconds.noise, "y1": seconds.noise,
          "fillcolor": "@noise", "opacity": 0.9, "line": {"width": 0}, "layer": "below"}  # fmt: skip
  layout = {
    "xaxis": axis(f"time in {seconds.recording} [s]", anchor="y2"),
    "yaxis": axis(channel.axis, domain=[0.42, 1.0]),
    "yaxis2": axis(f"error [{channel.symbol}]", domain=[0.0, 0.34]),
    "shapes": [band],
    "hovermode": "x",
    "legend": {"orientation": "h", "x": 0, "xanchor": "left", "y": 1.0, "yanchor": "bottom"},
  }  # fmt: skip
  return Chart(caption, traces, layout, 440)


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
  runs = runs_of(observations, predicted, LABELS, pool.floor, channels, per_cent(location.evidence), shaded)
  noun = SHARED[location.source]
  moments = [Moment(s.recording, s.start, s.end, f"{s.recording}, {s.start:.1f} to {s.end:.1f} s,"
                    f" {100 * s.share:.0f} % of the {noun}") for s in location.time]  # fmt: skip
  first = {m.run: k for k, m in reversed(list(enumerate(moments)))}
  runs.sort(key=lambda run: first.get(run.name, len(moments)))  # the page opens with the worst
  mapped = " Click the map to see the channels at that moment." if any(r.route for r in runs) else ""
  caption = (
    "Measured channels, and what the twins predict for the same commands. The seconds that hold most of the"
    f" {noun} are shaded. Lines break where the simulation restarts from the measurement.{mapped}"
  )
  return Explorer(caption, runs, moments, level=f"{noun} [%/s]", shade=f"seconds that hold most of the {noun}")


def per_cent(evidence: Array) -> Array:
  """Evidence per value as per cent of all that speaks for the mismatch, (M,)."""
  return 100.0 * evidence / max(abs(float(evidence.sum())), 1e-12)


def channel_shares(location: Location) -> Chart | None:
  """How the improvement, or the error, is spread over the channels."""
  rows = [(RESIDUALS[n].words, 100.0 * s, "twin", False) for n, s in location.channels.items() if s >= 0.005]
  return ranked(f"Share of the {SHARED[location.source]} by channel.", rows, "share [%]") if rows else None


def share_over_time(observations: Observations, location: Location) -> Chart:
  """Cumulative share through all recordings in order: it climbs where the mismatch acts."""
  order = np.lexsort((observations.time, observations.recording))
  recording = observations.recording[order]
  total = np.cumsum(per_cent(location.evidence)[order])
  clock = _driving_time(observations.time[order], recording)
  edges = np.concatenate([[0], np.flatnonzero(np.diff(recording)) + 1])
  keep = np.unique(np.concatenate([np.linspace(0, len(order) - 1, _POINTS).astype(int), edges]))
  names, noun = [observations.names[r] for r in recording[keep]], SHARED[location.source]
  trace = line(clock[keep], total[keep], "twin", "share", text=names, hovertemplate="%{text}: %{y:.0f} %")
  shapes = [{"type": "line", "yref": "paper", "y0": 0, "y1": 1, "x0": float(clock[e]), "x1": float(clock[e]),
             "layer": "below", "line": {"color": "@rule", "width": 1}} for e in edges]  # fmt: skip
  layout = {
    "xaxis": axis("driving time, all recordings in a row [s]"),
    "yaxis": axis("share so far [%]"),
    "shapes": shapes,
    "showlegend": False,
  }
  caption = f"Share of the {noun}, summed through the recordings. Thin lines mark where a recording begins."
  return Chart(caption, [trace], layout, 300)


def ranked_evidence(decision: Decision) -> Chart:
  """Bars of evidence, best first; claims in the twin's colour, names indistinguishable from them hatched."""
  claimed = {c.mechanism for c in decision.claims}
  equal = {name for c in decision.claims for name in c.indistinguishable_from}
  shown = [row for k, row in enumerate(decision.ranking[:_MOST]) if row[1] > 0.0 or k < _ALWAYS]
  rows = [(name, nats, "twin" if name in claimed else "nominal", name in equal) for name, nats in shown]
  caption = (
    "Evidence for each mechanism, best first. Blue bars are claims. Hatched bars are indistinguishable from a claim."
  )
  return ranked(caption, rows, "evidence [nats]")


def before_and_after(fits: Mapping[str, ChannelFit], where: str, repaired: bool = True) -> Chart | None:
  """RMS error per channel before and after, in multiples of the sensor noise; only before without a repair."""
  names = [n for n, f in fits.items() if np.isfinite([f.before, f.after]).all()]
  if not names:
    return None
  unit = {n: fits[n].noise or max(fits[n].before, 1e-12) for n in names}
  before, after = ([getattr(fits[n], key) / unit[n] for n in names] for key in ("before", "after"))
  low, high = ([fits[n].before * (1.0 + fits[n].ci95[k]) / unit[n] for n in names] for k in range(2))
  return bars(
    f"Errors on {where} in multiples of the sensor noise{', with 95 % intervals' if repaired else ''}.",
    [RESIDUALS[n].words for n in names],
    {"before": before, "twin": after} if repaired else {"before": before},
    "error / sensor noise",
    {"twin": (low, high)} if repaired else None,
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
