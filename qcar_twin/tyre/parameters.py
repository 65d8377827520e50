"""Names, units and places of a tyre's parameters in `geom_user` of a wheel geom.

The same list as the enum at the top of tyre.c. `mujoco.batch.Batch.expand("geom_user")` gives every
simulation its own tyres, wheel by wheel.
"""

from collections.abc import Mapping

TAG = 1.0  # first entry of a tyre's geom_user; any other geom has 0 there
COLUMN: Mapping[str, int] = {
  "tag": 0,
  "cornering_stiffness": 1,  # N/rad per wheel, at the nominal load
  "longitudinal_stiffness": 2,  # N per unit slip per wheel, at the nominal load
  "friction_coefficient": 3,  # peak force / load at the nominal load
  "tyre_shape": 4,  # C of sin(C atan(x / C)); 1 has no fall after the peak
  "load_exponent": 5,  # stiffness per load and friction fall with (load / nominal)^-exponent; 0 none
  "nominal_load": 6,  # N
  "relaxation_length": 7,  # m; 0 is the steady tyre
  "carcass_damping": 8,  # N s/m per wheel across, at standstill, fading above 0.1 m/s
}
_POSITIVE = ("cornering_stiffness", "longitudinal_stiffness", "friction_coefficient", "tyre_shape", "nominal_load")


def tyre_user_data(**values: float) -> list[float]:
  """The vector for `geom_user` of one wheel; every name of COLUMN but the tag is needed.

  Raises:
    ValueError: a name is missing or unknown, or a value that must be positive is not.
  """
  names = set(COLUMN) - {"tag"}
  if set(values) != names:
    raise ValueError(
      f"a tyre needs exactly {', '.join(sorted(names))}; missing {sorted(names - set(values))},"
      f" unknown {sorted(set(values) - names)}"
    )
  for name, value in values.items():
    if value < 0.0 or (name in _POSITIVE and value == 0.0):
      raise ValueError(f"tyre parameter '{name}' must be {'positive' if name in _POSITIVE else '>= 0'}, not {value:g}")
  vector = [TAG] + [0.0] * (len(COLUMN) - 1)
  for name, value in values.items():
    vector[COLUMN[name]] = float(value)
  return vector
