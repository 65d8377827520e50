"""Fit sessions without an effect by likelihood, and see whether what is left is white.

qcar-twin benchmark-likelihood --out docs/results_likelihood_nulls.md
"""

import dataclasses
from pathlib import Path

import numpy as np

from calibration.benchmarks.likelihood import LAGS, Whiteness, whiteness
from calibration.proving_ground import make_session
from qcar_twin import markdown
from qcar_twin.atomic_io import write_text


@dataclasses.dataclass(frozen=True)
class Config:
  """Sessions of the independent car without any concealed effect."""

  out: Path
  """Markdown file to write."""
  seed: int = 41010
  """Seed of the first session; the others follow it."""
  sessions: int = 5
  """How many cars."""
  poor: int = 0
  """Further starts for each, with other tyres and motors."""
  substeps: int = 5
  """Simulation steps per control period."""
  gaussian: bool = False
  """Trust every window alike, as a Gaussian likelihood does."""
  quick: bool = False
  """One car, a few seconds of driving, two linearisations."""


def row(seed: int, found: Whiteness) -> tuple[str, ...]:
  """One car."""
  largest = max(abs(c) for row in found.correlation.values() for c in row)
  inside = np.mean([abs(z) <= 1.645 for z in found.score.values()])
  noise = found.noise
  return (
    str(seed),
    f"{found.chi:.3f}",
    f"{largest:.3f}",
    f"{found.distrusted:.3f}",
    f"{noise['force_x']:.3f} / {noise['force_y']:.3f} / {noise['moment']:.4f}",
    f"{noise['memory']:.2f}",
    ", ".join(f"{name} {100 * e:+.1f} ({found.score[name]:+.1f})" for name, e in found.error.items()),
    f"{inside:.2f}",
    "-" if np.isnan(found.spread) else f"{found.spread:.1f}",
    str(found.simulations),
  )


def main(config: Config) -> None:
  """Run it and write the table."""
  seeds = [config.seed + k for k in range(1 if config.quick else config.sessions)]
  limits = {"seconds": 25.0, "steps": 2} if config.quick else {}
  limits |= {"substeps": config.substeps, "poor": config.poor, "gaussian": config.gaussian}
  found = [whiteness(make_session(s, (), "compact"), **limits) for s in seeds]
  titles = ("seed", "chi-square per reading", f"largest correlation at lags {LAGS[0]} to {LAGS[-1]}", "distrusted",
            "forces [N, N, N m]", "memory [s]", "error [%] (in standard deviations)", "within 90 %",
            "spread of poor starts [nats]", "simulations")  # fmt: skip
  lines = [
    "The proving ground's noise: 0.05 N, 0.07 N, 0.004 N m at 2.7 kg, memory 0.15 s; wheel loads err by 3 %.",
    "",
    *markdown.table(titles, [row(s, f) for s, f in zip(seeds, found, strict=True)]),
  ]
  text = "\n".join(lines) + "\n"
  write_text(config.out, text)
  print(text)
