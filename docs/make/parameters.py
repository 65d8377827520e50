"""The page of the base twin's parameters, from their table.

python -m docs.make.parameters > docs/reference/parameters.md
"""

from qcar_twin.parameters import Parameter
from qcar_twin.twin.parameters import base_parameters
from qcar_twin.vehicle.vehicle import Vehicle

_HEAD = """# Parameters of the base twin

This page is written by `python -m docs.make.parameters`. Every fit has these parameters, here of a QCar as
`assets/qcar.toml` describes it. Each is known in one of three ways:

* **measured**: on this car, with a scale, a ruler or on a bench; the prior is normal with the standard deviation in
  `[vehicle.std]`.
* **class**: nobody measured it on this car. The prior is log-normal about a figure usual of small electric cars, one
  standard deviation is the factor stated, or it is normal with the deviation stated. A car's own `std` in
  `[vehicle.std]` makes it measured. A bound that is hit is moved once by a factor of two, unless the range reaches 0,
  and said; an estimate beyond two deviations is said, too.
* **open**: known to an order of magnitude; the recordings decide, within the bounds. One that is hit is moved
  likewise.

Figures of cars of another size go by their wheelbase ([sizes](sizes.md)). The errors of sensors and linkages that every
fit allows for besides are in [mechanisms](mechanisms.md).

| parameter | symbol | nominal | prior | bounds |
|---|---|---|---|---|"""


def page() -> str:
  """The whole page."""
  return "\n".join([_HEAD, *(_row(p) for p in base_parameters(Vehicle.load()))]) + "\n"


def _row(p: Parameter) -> str:
  unit = "" if p.unit == "-" else f" {p.unit}"
  return f"| `{p.name}` | {p.symbol} | {p.nominal:.3g}{unit} | {p.prior} | {p.lower:.3g} to {p.upper:.3g} |"


if __name__ == "__main__":
  print(page(), end="")
