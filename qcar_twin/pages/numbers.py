"""Numbers as pages print them."""

import math


def spread(value: float, std: float | None) -> str:
  """ "0.0412 ± 0.0021": a value with its standard deviation to two digits, both to the same place."""
  if std is None or not math.isfinite(std) or std <= 0:
    return f"{value:.3g}"
  places = 1 - math.floor(math.log10(std))
  if places <= 0:
    return f"{round(value, places):.0f} ± {round(std, places):.0f}"
  return f"{value:.{places}f} ± {std:.{places}f}" if places <= 6 else f"{value:.3g} ± {std:.2g}"
