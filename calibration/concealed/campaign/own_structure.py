"""Claims on the second car that name what every such car has by itself, next to the car's own number.

Its servo turns no faster than a limit (docs/reference/second_car.md), which the twin has only as a mechanism. The
truth lists effects that were added, so such a claim counts as wrong in every score, though it is true of the car.
"""

import dataclasses
from collections.abc import Callable, Sequence

from calibration.concealed.campaign.score import Result
from calibration.concealed.second_car import SecondCar, drawn_car
from qcar_twin import markdown

OWN: dict[str, tuple[str, Callable[[SecondCar], float]]] = {
  "steering_rate_limit": ("steering_inverse_rate", lambda car: 1.0 / car.servo_speed),
}


@dataclasses.dataclass(frozen=True)
class OwnClaim:
  """A claim of what such a car has: its number as reported, with a standard deviation, and the car's own."""

  case: str
  mechanism: str
  reported: float
  std: float
  own: float

  @property
  def deviations(self) -> float:
    """By how many standard deviations reported and own number differ."""
    return (self.reported - self.own) / self.std


def own_claims(results: Sequence[Result]) -> list[OwnClaim]:
  """Claims of OWN that were not concealed, of all answered sessions of the second car."""
  claims = []
  for result in results:
    case = result["case"]
    if case.get("car") != "second":
      continue
    concealed = {name for name, _ in case["effects"]}
    for claim in result["answer"]["claims"]:
      name = claim["mechanism"]
      if name in OWN and name not in concealed:
        parameter, number = OWN[name]
        reported = claim["parameters"][parameter]
        own = number(drawn_car(case["seed"]))
        claims.append(OwnClaim(case["name"], name, reported["value"], reported["std"], own))
  return claims


def own_table(results: Sequence[Result]) -> str:
  """The same as Markdown; "" without any."""
  claims = own_claims(results)
  if not claims:
    return ""
  titles = ("case", "claim", "reported", "the car's own", "standard deviations apart")
  rows = [
    (c.case, c.mechanism, f"{c.reported:.4f} ± {c.std:.4f}", f"{c.own:.4f}", f"{c.deviations:+.1f}") for c in claims
  ]
  return "\n".join(markdown.table(titles, rows)) + "\n"
