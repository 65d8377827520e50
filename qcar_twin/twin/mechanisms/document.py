"""The catalogue as a page to read, made from the mechanisms' own declarations and docstrings.

`python -m qcar_twin.twin.mechanisms.document docs/reference/mechanisms.md` writes the page; no mechanism is defined
here.
"""

import re
import sys
from pathlib import Path

from qcar_twin.atomic_io import write_text
from qcar_twin.twin.mechanisms import by_subsystem, catalogue
from qcar_twin.twin.mechanisms.base import SUBSYSTEMS, CarDimensions, Mechanism
from qcar_twin.vehicle.vehicle import Vehicle

_SECTION = re.compile(r"^  (Equation|Units|Source|Size|Confounded with): ", re.MULTILINE)
_INTRODUCTION = """# Mechanisms

Physics that can be added to the twin, one file each in `qcar_twin/twin/mechanisms/`: [how to add
one](../guide/extending.md). At its null, 0 in every case, a mechanism is not run at all. A typical size is what a
search and a scan try first; it decides no claim. *Size* says where it comes from: a source, or a stated prior with
its reason. The car meant is the QCar of 2.7 kg.
Signs follow ISO 8855. This page is written by `python -m qcar_twin.twin.mechanisms.document`.
"""


def sections(mechanism: Mechanism) -> dict[str, str]:
  """Parts of a mechanism's docstring by title, each on one line; the first line is "Summary"."""
  text = type(mechanism).__doc__ or ""
  parts = _SECTION.split(text)
  named = {"Summary": parts[0], **dict(zip(parts[1::2], parts[2::2], strict=True))}
  return {title: " ".join(body.split()) for title, body in named.items()}


def page() -> str:
  """The whole catalogue in Markdown."""
  lines = [_INTRODUCTION, "| mechanism | stage | typical size | what it is |", "|---|---|---|---|"]
  ordered = by_subsystem(catalogue().values())
  lines += [f"| [{m.name}](#{m.name}) | {m.stage} | {_sizes(m)} | {sections(m)['Summary']} |" for m in ordered]
  for subsystem in SUBSYSTEMS:
    lines += ["", f"## {subsystem.capitalize()}"]
    for mechanism in ordered:
      if mechanism.subsystem == subsystem:
        lines += _entry(mechanism)
  return "\n".join(lines) + "\n"


def _sizes(mechanism: Mechanism) -> str:
  sign = "±" if mechanism.signed else ""
  return ", ".join(f"{sign}{p.typical:g} {p.unit}" for p in mechanism.parameters if p.null is not None)


def _usual(mechanism: Mechanism) -> str:
  """What every model fits of it at most, of the QCar."""
  car = Vehicle.load()
  stds = mechanism.tolerances(CarDimensions.of(car), car.std)
  most = [f"{3.0 * stds[p.name]:.2g} {p.unit}".removesuffix(" -") for p in mechanism.parameters if stds.get(p.name)]
  return "up to " + " and ".join(dict.fromkeys(most)) if most else ""


def _entry(mechanism: Mechanism) -> list[str]:
  text = sections(mechanism)
  flags = ["dissipative"] * mechanism.dissipative + ["not mirror-symmetric"] * (not mechanism.symmetric)
  flags += [f"needs {' and '.join(mechanism.needs)}"] * bool(mechanism.needs)
  flags += ["every model fits what all such sensors have of it"] * bool(mechanism.sensor_errors)
  flags += [f"every model fits what is usual of it, {most}" for most in [_usual(mechanism)] if most]
  lines = ["", f"### {mechanism.name}", "", text["Summary"] + (f" *{', '.join(flags).capitalize()}.*" if flags else "")]
  lines += [
    "",
    *(
      f"* {title}: {text[title]}"
      for title in ("Equation", "Units", "Source", "Size", "Confounded with")
      if title in text
    ),
  ]
  for p in mechanism.parameters:
    kind = f"size, typically {p.typical:g}" if p.null is not None else f"shape, {p.nominal:g} at first"
    lines.append(f"* `{p.name}` ({p.symbol}) in [{p.lower:g}, {p.upper:g}] {p.unit}: {p.description}; {kind}")
  return lines


def write(path: Path) -> None:
  """Write the page to a file, through a temporary one."""
  write_text(path, page())


if __name__ == "__main__":
  write(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/reference/mechanisms.md"))
