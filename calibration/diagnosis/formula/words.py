"""A formula in words: one sentence, and why it is or is not shipped."""

from calibration.diagnosis.formula.dictionary import Group
from calibration.diagnosis.formula.finding import Found
from calibration.diagnosis.formula.forms import HOLDS
from qcar_twin.twin.formula.degrees import DEGREES
from qcar_twin.twin.formula.table import Table
from qcar_twin.twin.formula.variables import VARIABLES
from qcar_twin.twin.formula.written import equation_of


def equation(found: Found) -> str:
  """F_x = -(1.19 +- 0.06 N s/rad) |r| sgn(v); "" where nothing is shipped."""
  if not (found.kind and found.twin):
    return ""
  law = found.twin.mechanism.law
  if isinstance(law, Table):
    return equation_of(law)
  said = [f"({value:.3g} ± {std:.2g} {p.unit})" for p, value, std in found.twin.values]
  numbers, place = said[: len(law.terms)], found.twin.values[len(law.terms) :]
  spot = ", ".join(f"{p.symbol} = {value:.3g} ± {std:.1g} m" for p, value, std in place)
  return f"{equation_of(law, numbers)}{', ' + spot if spot else ''}"


def variables(found: Found) -> list[str]:
  """What it is a function of, by the names of VARIABLES."""
  if found.twin is None or found.sought is None or found.sought.forms is None:
    return []
  law = found.twin.mechanism.law
  return sorted(law.knots if isinstance(law, Table) else Group(law.parsed, law.near).variables)


def alike_words(found: Found) -> str:
  """Other places where it could act; and other variables, "" without any."""
  other = [DEGREES[name].words for name in found.alike]
  forms = found.sought.forms if found.sought else None
  mine = set(variables(found))
  for form in forms.rivals if forms and found.kind == "formula" else ():
    if set(form.variables) != mine:
      other.append("a function of " + " and ".join(VARIABLES[v].words for v in form.variables))
  return ", or ".join(other)


def _taken(change: float | None) -> str:
  if change is None:
    return "is found in what was fitted; no held-out recordings show what it is worth"
  size, errors = abs(100.0 * (change - 1.0)), "the held-out errors (geometric mean over the channels)"
  return f"takes {size:.0f} % off {errors}" if change <= 1.0 else f"adds {size:.0f} % to {errors}"


def sentence(found: Found, change: float | None = None) -> str:
  """What was found, in one or two sentences.

  Args:
    found: of `find_formula`.
    change: held-out errors, after over before; None without any.
  """
  if found.sought is None or found.sought.forms is None:
    return f"No formula was found: {found.why}."
  degree, forms = DEGREES[found.sought.recovered.degree], found.sought.forms
  words = " and ".join(dict.fromkeys(VARIABLES[v].words for v in variables(found) or forms.best.variables))
  if not found.kind:
    return f"{degree.words.capitalize()} that follows {words} explains some of it, but {found.why}."
  said = f"{degree.words.capitalize()} that follows {words}"
  if found.kind == "formula":
    said += f", {equation(found)},"
  else:
    said += f", as a table, since no formula holds {HOLDS:.0%} of what the table does,"
  said += f" {_taken(change)}."
  alike = alike_words(found)
  return f"{said} These recordings can't tell it from {alike}." if alike else said
