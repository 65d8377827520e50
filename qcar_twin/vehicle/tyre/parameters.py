"""Names, units and places of a tyre's parameters in `geom_user` of a wheel geom.

The C header with the same places is written from this list when the plugin is built.
`mujoco.batch.Batch.expand("geom_user")` gives every simulation its own tyres, wheel by wheel.
"""

from collections.abc import Mapping

from qcar_twin.vehicle.tyre.laws import DEFAULT, law_parameters, tyre_laws

_COMMON = (
  "tag",  # number of the wheel's law, from 1; any geom without a tyre has 0 there
  "cornering_stiffness",  # N/rad per wheel, at the nominal load
  "longitudinal_stiffness",  # N per unit slip per wheel, at the nominal load
  "friction_coefficient",  # peak force / load at the nominal load
  "load_exponent",  # stiffness per load and friction fall with (load / nominal)^-exponent; 0 none
  "nominal_load",  # N
  "relaxation_length",  # m, of slip across; 0 is the steady tyre
  "longitudinal_relaxation",  # m, of slip along
  "carcass_damping",  # N s/m per wheel across, at standstill, fading above 0.1 m/s
  "rim_mass",  # kg, that turns with the wheel, at its rim: how well a step follows slip along; 0 for backward Euler
)
_POSITIVE = ("cornering_stiffness", "longitudinal_stiffness", "friction_coefficient", "nominal_load")
COLUMN: Mapping[str, int] = {
  name: i for i, name in enumerate((*_COMMON, *(p.name for own in tyre_laws().values() for p in own)))
}


def tyre_user_data(law: str = DEFAULT, **values: float) -> list[float]:
  """The vector for `geom_user` of one wheel; what all laws share and the law's own parameters are needed.

  Raises:
    ValueError: unknown law, a name is missing or unknown, or a value lies where it makes no sense.
  """
  own = {p.name: p for p in law_parameters(law)}
  names = {*_COMMON[1:], *own}
  if set(values) != names:
    raise ValueError(
      f"a tyre needs exactly {', '.join(sorted(names))}; missing {sorted(names - set(values))},"
      f" unknown {sorted(set(values) - names)}"
    )
  for name, value in values.items():
    if value < 0.0 or (value == 0.0 and (name in _POSITIVE or (name in own and own[name].lower > 0.0))):
      least = "positive" if name in _POSITIVE or name in own else ">= 0"
      raise ValueError(f"tyre parameter '{name}' must be {least}, not {value:g}")
  vector = [0.0] * len(COLUMN)
  vector[COLUMN["tag"]] = 1.0 + list(tyre_laws()).index(law)
  for name, value in values.items():
    vector[COLUMN[name]] = float(value)
  return vector


def header() -> str:
  """laws.h: the places of `geom_user` as a C enum, every law's function, and the choice by a wheel's tag."""
  laws = list(tyre_laws())
  lines = [f"enum {{ {', '.join(name.upper() for name in COLUMN)}, N_PARAMETER }};", ""]
  lines += [f'#include "{law}.h"' for law in laws]
  lines += ["", "static inline mjtNum secant(const mjtNum* u, mjtNum rho) {", "  switch ((int)u[TAG]) {"]
  lines += [f"    case {i}: return {law}_secant(u, rho);" for i, law in enumerate(laws[1:], 2)]
  return "\n".join([*lines, f"    default: return {laws[0]}_secant(u, rho);", "  }", "}", ""])
