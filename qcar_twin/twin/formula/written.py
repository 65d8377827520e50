"""A formula as a file: Python that a person reads, changes and keeps, written from a template of data.

Numbers are written by `repr`, names and texts as quoted strings; nothing of it is executed here. Who runs it says so
himself, with `--mechanism-files`. A twin file holds the same as a table of its own, which is read as data.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from qcar_twin.atomic_io import write_text
from qcar_twin.parameters import Parameter
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.law import Law
from qcar_twin.twin.formula.mechanism import Formula, made
from qcar_twin.twin.formula.table import Table
from qcar_twin.twin.formula.variables import VARIABLES, spell

_FILE = '''"""{summary}

Found by a diagnosis of {dataset}. It is a mechanism like any of the catalogue's; change it and run it again:

  qcar-twin diagnose --dataset FOLDER --out OUT --mechanism-files {name}.py

A term is a product of variables and of operations on them: value, abs, square, sign; cos, sin, cos2, sin2 of an angle.
Variables: {variables}.
"""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.formula import Formula, {kind}


class {class_name}(Formula):
  """{summary}

  Equation: {equation}; 0 at rest where it pushes the car.
  Units: {units}.
  Source: a fit to {dataset}; {validity}
  Confounded with: {alike}.
  """

  name = {name!r}
  subsystem, stage = {subsystem!r}, {stage!r}
  parameters = (
{parameters}
  )
  law = {law}
'''


def equation_of(law: Law | Table, symbols: Sequence[str] | None = None) -> str:
  """F_x = c_1 |r| sgn(v), with other symbols or numbers in place of c_1, c_2, ... where they are given."""
  symbol = DEGREES[law.degree].symbol
  if isinstance(law, Table):
    return f"{symbol} = table({', '.join(VARIABLES[name].symbol for name in law.knots)})"
  named = symbols or [f"c_{k}" for k in range(1, len(law.terms) + 1)]
  body = " + ".join(f"{c} {term.equation}".rstrip() for c, term in zip(named, law.parsed, strict=True))
  spot = "exp(-d^2 / 2 radius^2), d from (x, y)"
  return f"{symbol} = ({body}) {spot}" if law.near else f"{symbol} = {body}"


def write_mechanism(
  path: str | Path, mechanism: Formula, values: Sequence[tuple[Parameter, float, float]], dataset: str, alike: str = ""
) -> Path:
  """Write a formula as a mechanism file.

  Args:
    path: file to write, NAME.py.
    mechanism: the formula.
    values: its parameters with value and standard deviation.
    dataset: that it was found in.
    alike: what explains the same as well, in words.
  """
  law, degree = mechanism.law, DEGREES[mechanism.law.degree]
  fitted = {p.name: (value, std) for p, value, std in values}
  content = _FILE.format(
    summary=f"{degree.words.capitalize()} without a name.",
    dataset=_plain(dataset),
    name=mechanism.name,
    kind=type(law).__name__,
    class_name="".join(part.capitalize() for part in mechanism.name.split("_")),
    equation=equation_of(law),
    units=f"{degree.symbol} {degree.unit}; "
    + ", ".join(f"{VARIABLES[n].symbol} {spell(VARIABLES[n].unit)}" for n in sorted(law.variables)),
    validity=f"not beyond {_ranges(law)}.",
    alike=_plain(alike) or "nothing that was tried",
    subsystem=degree.subsystem,
    stage=degree.stage,
    variables=", ".join(VARIABLES),
    parameters="\n".join(f"    {_parameter(p, *fitted[p.name])}" for p in mechanism.parameters),
    law=_law(law),
  )
  return write_text(path, content)


def described(mechanism: Formula) -> dict[str, Any]:
  """A formula as plain data, for a twin file; `from_described` reads it."""
  law = mechanism.law
  out: dict[str, Any] = {"degree": law.degree, "limit": float(law.limit)}
  if isinstance(law, Table):
    out |= {"knots": [[name, *map(float, at)] for name, at in law.knots.items()]}
  else:
    out |= {"terms": list(law.terms), "near": [float(x) for x in law.near],
            "ranges": [[name, float(low), float(high)] for name, (low, high) in law.ranges.items()]}  # fmt: skip
  rows = [
    [p.name, p.nominal, p.lower, p.upper, p.unit, p.symbol, p.null, p.std, p.typical] for p in mechanism.parameters
  ]
  return out | {"parameters": [["" if x is None else x for x in row] for row in rows]}


def from_described(name: str, table: Mapping[str, Any]) -> Formula:
  """A formula from plain data.

  Raises:
    ValueError, KeyError, TypeError: what is missing or not as it should be.
  """
  degree, limit = str(table["degree"]), float(table["limit"])
  if degree not in DEGREES:
    raise ValueError(f"formula '{name}' acts on '{degree}'; there are {', '.join(DEGREES)}")
  law: Law | Table
  if "knots" in table:
    law = Table(degree, {str(n): tuple(map(float, at)) for n, *at in table["knots"]}, limit)
  else:
    ranges = {str(n): (float(low), float(high)) for n, low, high in table["ranges"]}
    law = Law(degree, tuple(map(str, table["terms"])), ranges, limit, tuple(map(float, table.get("near", ()))))
    law.parsed  # noqa: B018  # an unknown term is refused here, with what there is
  given = lambda x: None if x == "" else float(x)
  parameters = [
    Parameter(str(n), float(nominal), float(low), float(high), str(unit), str(symbol),
              null=given(null), std=given(std), typical=given(typical))
    for n, nominal, low, high, unit, symbol, null, std, typical in table["parameters"]
  ]  # fmt: skip
  return made(name, law, parameters)


def _parameter(p: Parameter, value: float, std: float) -> str:
  said = lambda x: repr(None if x is None else float(x))
  bounds = ", ".join(map(said, (p.nominal, p.lower, p.upper)))
  first = f"Parameter({p.name!r}, {bounds}, {p.unit!r}, {p.symbol!r}, null={said(p.null)},"
  rest = f"std={said(p.std)}, typical={said(p.typical)}),  # fitted: {value:.4g} +- {std:.2g} {p.unit}"
  return f"{first}\n              {rest}"


def _law(law: Law | Table) -> str:
  if isinstance(law, Table):
    knots = "".join(f"      {name!r}: {tuple(map(float, at))!r},\n" for name, at in law.knots.items())
    return (
      f"Table(\n    {law.degree!r},\n    knots={{\n{knots}    }},\n    limit={float(law.limit)!r},  # {_unit(law)}\n  )"
    )
  ranges = "".join(f"      {n!r}: {(float(a), float(b))!r},  # {spell(VARIABLES[n].unit)}, not beyond\n"
                   for n, (a, b) in law.ranges.items())  # fmt: skip
  near = f"    near={tuple(map(float, law.near))!r},  # x, y, radius at first, m\n" if law.near else ""
  return (f"Law(\n    {law.degree!r},\n    terms={tuple(law.terms)!r},\n    ranges={{\n{ranges}    }},\n"
          f"    limit={float(law.limit)!r},  # {_unit(law)}\n{near}  )")  # fmt: skip


def _unit(law: Law | Table) -> str:
  return DEGREES[law.degree].unit


def _ranges(law: Law | Table) -> str:
  spans = law.ranges if isinstance(law, Law) else {name: (at[0], at[-1]) for name, at in law.knots.items()}
  return ", ".join(
    f"{VARIABLES[n].symbol} {a:.3g} to {b:.3g} {spell(VARIABLES[n].unit)}" for n, (a, b) in spans.items()
  )


def _plain(text: str) -> str:
  """A text that cannot end the docstring it is put into."""
  return " ".join(text.split()).replace("\\", "/").replace('"', "'")
