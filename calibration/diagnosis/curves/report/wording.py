"""What free curves found, in plain sentences: what departs, under which name, by how much, and what it gains."""

from collections.abc import Mapping

from calibration.diagnosis.curves.naming.forms import Outline
from calibration.diagnosis.curves.naming.terms import Term
from calibration.diagnosis.curves.report.shapes import Shape
from calibration.diagnosis.curves.study import Study
from calibration.diagnosis.holdout_errors import ratio
from calibration.diagnosis.report.wording import amount, happening, listed
from calibration.fitting.residual_channels import RESIDUALS
from qcar_twin.pages.numbers import spread
from qcar_twin.twin.mechanisms import select

_MOST = 3  # of what stands out, named in a sentence; the table has all


def verdict(found: Study, drawn: tuple[Shape, ...]) -> str:
  """What departs from the base car's laws and whether the twin with curves predicts better: the page's first words."""
  return f"{departures(found, drawn)} {gain_sentence(found)}"


def departures(found: Study, drawn: tuple[Shape, ...]) -> str:
  """ "Steering departs from the base car's law, most clearly by 1.2 ± 0.1° …, as steering_nonlinearity would."."""
  told = [departure(o, s) for o, s in zip(found.outlines, drawn, strict=True) if o.is_there]
  kept = [s.part for o, s in zip(found.outlines, drawn, strict=True) if not o.is_there]
  if kept:
    whose = listed(kept).capitalize()
    more = "no departure shows" if told else "no departure from the base car's laws shows"
    told.append(f"{whose}: {more}.")
  beside = sorted((t for t in found.terms if t.there), key=lambda t: -abs(t.value) / t.std)
  before, after, where = compared(found)
  if beside and after and ratio(after, before) >= 1.0:
    told.append(f"Free figures predict {where} no better than the base does, so they say nothing of the car.")
  elif beside:
    rest = f" and {len(beside) - _MOST} more" if len(beside) > _MOST else ""
    told.append(
      f"Among the other parameters, these stand out: {', '.join(term_words(t) for t in beside[:_MOST])}{rest}."
    )
  return " ".join(told) or "No map could be seen in these recordings."


def departure(outline: Outline, shape: Shape) -> str:
  """One curve that is there, in a sentence."""
  value, std, where = shape.clearest
  gap = "" if shape.y_unit == "°" else " "
  place = f"{where:.2g}{'' if shape.x_unit.startswith('°') else ' '}{shape.x_unit}"
  size = f"{spread(value, std)}{gap}{shape.y_unit} (at {place})".replace("-", "−")
  text = f"{shape.part.capitalize()} departs from the base car's law, most clearly by {size}"
  if (form := outline.nearly) is not None:
    left = f"{100.0 * outline.left(form):.0f} % of what it is worth is left"
    return f"{text}, nearly as {listed(form.mechanisms)} would: {left}, more than chance leaves of a right name."
  if outline.named is None:
    return f"{text}, in a shape that no named form has."
  others = len(outline.possible) - 1
  rivals = f" ({others} other form{'s fit' if others > 1 else ' fits'} as well)" if others else ""
  return f"{text}, as {listed(outline.named.mechanisms)} would{rivals}."


def form_words(outline: Outline) -> str:
  """What a curve's name means, or what the curve nearly is, and how large it is; "" without either."""
  form = outline.told
  if form is None:
    return ""
  mechanisms = select(form.mechanisms)
  said = []
  for mechanism in mechanisms:
    sizes = [
      f"{p.description or p.name.replace('_', ' ')} {amount(form.values[p.name], form.std[p.name], p.unit)}"
      for p in mechanism.parameters
    ]
    said.append(f"{mechanism.name}: {happening(mechanism)}; {', '.join(sizes)}")
  return ". ".join(said)


def term_words(term: Term) -> str:
  """ "encoder_latency 41 ± 2 ms"."""
  return f"{term.name.replace('@', ' in session ')} {amount(term.value, term.std, term.unit).replace('-', '−')}"


def gain_sentence(found: Study) -> str:
  """Whether the characterised twin predicts recordings that took no part better, by channel."""
  before, after, where = compared(found)
  if not after:
    return "There are no held-out recordings, so nothing shows whether the characterised twin predicts better."
  named = found.errors.get("named")
  alone = f" With the named forms alone it {errs(named, before)}." if named else ""
  return f"On {where} the characterised twin {errs(after, before)} than the base: {changes(after, before)}.{alone}"


def compared(found: Study) -> tuple[Mapping[str, float], Mapping[str, float], str]:
  """Errors of the base and of the characterised twin on the recordings that tell most, and which those are; or {}.

  The hold-out where there is one, else what judged.
  """
  if found.errors:
    return found.errors["base"], found.errors["characterised"], "held-out recordings"
  return found.judged.get("base", {}), found.judged.get("characterised", {}), "validation recordings"


def errs(after: Mapping[str, float], before: Mapping[str, float]) -> str:
  """ "errs 12 % less": geometric mean over the channels."""
  share = 100.0 * (ratio(after, before) - 1.0)
  return f"errs {abs(share):.0f} % {'less' if share < 0.0 else 'more'}"


def changes(after: Mapping[str, float], before: Mapping[str, float]) -> str:
  """ "yaw rate −12 %, motor speed +1 %": by channel, the best first."""
  shares = {name: 100.0 * (after[name] / before[name] - 1.0) for name in before if name in after and before[name] > 0.0}
  told = [f"{RESIDUALS[name].words} {share:+.0f} %" for name, share in sorted(shares.items(), key=lambda kv: kv[1])]
  return ", ".join(told).replace("-", "−")
