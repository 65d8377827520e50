"""What a diagnosis leaves behind for programs: `diagnosis.json`.

`document` builds the JSON from plain Python types, `faults` checks it against the schema, and
nothing that fails the check is written.
"""

import dataclasses
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.diagnosis.candidates import Candidate
from calibration.diagnosis.decision.claims import Claim
from calibration.diagnosis.decision.decide import Decision
from calibration.diagnosis.decision.structure import PROPERTIES
from calibration.diagnosis.formula.after import Shipped
from calibration.diagnosis.formula.words import equation, variables
from calibration.diagnosis.holdout_errors import ChannelFit
from calibration.diagnosis.locate import Location
from calibration.diagnosis.outcome import Diagnosis
from calibration.diagnosis.unexplained.unknown import smooth_forces
from qcar_twin.atomic_io import plain, write_json

VERDICTS = ("no_mismatch", "explained", "partly_explained", "unexplained")
SHIPPED = ("repaired", "recalibrated", "curves")
LISTED = 5  # alternatives of a claim
FILE, REPORT, FIGURES = "diagnosis.json", "report.html", "figures"


def write_document(
  folder: str | os.PathLike[str],
  diagnosis: Diagnosis,
  curves: Mapping[str, Any] | None = None,
  shipped: str = "repaired",
  curved: Mapping[str, Mapping[str, ChannelFit]] | None = None,
) -> Path:
  """Write diagnosis.json; returns its path.

  Args:
    curves: what free curves show, as plain values; None where they were not fitted.
    shipped: which twin is written as twin.toml, one of SHIPPED.
    curved: errors of the twin with free curves, by role and channel.

  Raises:
    ValueError: the document breaks the schema; says where, and writes nothing.
  """
  content = document(diagnosis, curves, shipped, curved)
  found = faults(content)
  if found:
    raise ValueError(f"{FILE} breaks its schema: {'; '.join(found[:5])}")
  return write_json(Path(folder) / FILE, content)


def document(
  diagnosis: Diagnosis,
  curves: Mapping[str, Any] | None = None,
  shipped: str = "repaired",
  curved: Mapping[str, Mapping[str, ChannelFit]] | None = None,
) -> dict[str, Any]:
  """The JSON of a diagnosis as plain Python types; a number that is not finite becomes null."""
  d, pool, own = diagnosis, diagnosis.pool, curved or {}
  return plain(
    {
      "dataset": d.dataset,
      "verdict": d.decision.verdict,
      "claims": [_claim(c) for c in d.decision.claims],
      "departures": [dataclasses.asdict(x) for x in d.decision.departures],
      "ranking": [{"mechanism": name, "evidence_nats": nats} for name, nats in d.decision.ranking],
      "where": _where(d.location),
      "unknown": unknown_summary(d.decision) | _formula(d.formula),
      "parameter_shifts": parameter_shifts(pool.base),
      "untestable": sorted(s.mechanism for s in pool.signatures.values() if not s.testable),
      "concealment": {name: s.unabsorbed_share for name, s in sorted(pool.signatures.items())},
      "detectable": {name: {key: getattr(x, key) for key in _DETECTABLE} for name, x in d.detectable.items()},
      "next_experiment": d.next_experiment,
      "fit": {role: _fits(getattr(d, role), own.get(role, {})) for role in ("validate", "holdout")},
      "curves": curves,
      "shipped": shipped,
      "seconds": d.seconds,
    }
  )


def parameter_shifts(model: Candidate) -> dict[str, dict[str, float]]:
  """Per base parameter: prior, fitted, and the shift in prior standard deviations (`sigma`)."""
  return {
    p.name: {
      "prior": p.nominal,
      "fitted": float(model.values[i]),
      "sigma": float(model.free.deviations(model.values)[i]),
    }
    for i, p in enumerate(model.free)
  }


def unknown_summary(decision: Decision) -> dict[str, Any]:
  """What a nameless error would depend on, where the verdict rests on one.

  Variables and properties are those of the strongest structure that is left over, of the best UNKNOWN rival where
  nothing is. `share` is the part of that rival's held-out gain that the named mechanisms do not reach.
  """
  out = {"depends_on": [], "properties": [], "formula": None, "share": 0.0}
  if not decision.nameless:
    return out
  if decision.unknown is not None:
    name, comparison = decision.unknown
    known = sum(max(c.held_out.gain, 0.0) for c in decision.claims)
    share = 1.0 - known / comparison.gain if comparison.gain > 0 else 0.0
    out |= {"depends_on": unknown_variables(name), "share": float(np.clip(share, 0.0, 1.0))}
  if decision.leftovers:
    families = list(dict.fromkeys(item.family for item in decision.leftovers))
    out |= {"depends_on": list(decision.leftovers[0].depends_on), "properties": [PROPERTIES[f] for f in families]}
  return out


def _formula(shipped: Shipped | None) -> dict[str, Any]:
  """The formula of what has no name, and its variables, where it is kept."""
  if shipped is None or not shipped.kept:
    return {}
  return {"formula": equation(shipped.rest), "depends_on": variables(shipped.rest)}


def unknown_variables(name: str) -> list[str]:
  """Variables an UNKNOWN rival is a function of."""
  for force in smooth_forces():
    if force.name == name:
      return list(getattr(force, "variables", ()))
  return ["velocity_x", "yaw_rate", "accel_x", "accel_y"]


def _claim(claim: Claim) -> dict[str, Any]:
  return {
    "mechanism": claim.mechanism,
    "probability": claim.probability,
    "evidence_nats": claim.evidence_nats,
    "parameters": {name: dict(row) for name, row in claim.parameters.items()},
    "alternatives": [{"mechanism": name, "evidence_nats": nats} for name, nats in claim.alternatives[:LISTED]],
    "indistinguishable_from": list(claim.indistinguishable_from),
  }


def _where(location: Location) -> dict[str, Any]:
  return {
    "subsystem": location.subsystem,
    "channels": location.channels,
    "time": [dataclasses.asdict(span) for span in location.time],
    "region": location.region.rule,
    "region_share": location.region.share,
  }


def _fits(fits: Mapping[str, ChannelFit], curved: Mapping[str, ChannelFit]) -> dict[str, Any]:
  row = lambda name, fit: {
    "before": fit.before, "after": fit.after, "curves": curved[name].after if name in curved else None,
    "noise_floor": fit.noise_floor, "driving_noise": fit.driving_noise, "ci95": list(fit.ci95),
  }  # fmt: skip
  return {name: row(name, fit) for name, fit in fits.items()}


# Schema: a type, a tuple of allowed values, [item], {"*": value} for any keys, or a dict of exactly these keys.
_NUMBER = float
_MAYBE = ("number or null",)  # a channel without enough data has no error
_CHANNEL = {"*": {"before": _MAYBE, "after": _MAYBE, "curves": _MAYBE, "noise_floor": _MAYBE, "driving_noise": _MAYBE,
                  "ci95": [_MAYBE]}}  # fmt: skip
_DETECTABLE = {"parameter": str, "unit": str, "size": _MAYBE, "named": _MAYBE, "share": _MAYBE, "nats": _MAYBE}
SCHEMA: dict[str, Any] = {
  "dataset": str,
  "verdict": VERDICTS,
  "claims": [
    {
      "mechanism": str,
      "probability": _NUMBER,
      "evidence_nats": _NUMBER,
      "parameters": {"*": {"value": _NUMBER, "std": _NUMBER, "unit": str}},
      "alternatives": [{"mechanism": str, "evidence_nats": _NUMBER}],
      "indistinguishable_from": [str],
    }
  ],
  "departures": [
    {"name": str, "value": _NUMBER, "measured": _NUMBER, "std": _NUMBER, "z": _NUMBER, "unit": str, "usual": bool}
  ],
  "ranking": [{"mechanism": str, "evidence_nats": _NUMBER}],
  "where": {
    "subsystem": str,
    "channels": {"*": _NUMBER},
    "time": [{"recording": str, "start": _NUMBER, "end": _NUMBER, "share": _NUMBER}],
    "region": str,
    "region_share": _NUMBER,
  },
  "unknown": {"depends_on": [str], "properties": [str], "formula": "str or null", "share": _NUMBER},
  "parameter_shifts": {"*": {"prior": _NUMBER, "fitted": _NUMBER, "sigma": _NUMBER}},
  "untestable": [str],
  "concealment": {"*": _NUMBER},
  "detectable": {"*": _DETECTABLE},
  "next_experiment": "experiment or null",
  "fit": {"validate": _CHANNEL, "holdout": _CHANNEL},
  "curves": "object or null",
  "shipped": SHIPPED,
  "seconds": _NUMBER,
}
_OPTIONAL: dict[str, Any] = {
  "str or null": str,
  "object or null": dict,  # its keys are those of curves.json
  "experiment or null": {"manoeuvre": str, "separates": [str], "predicted_nats": _NUMBER},
}


def faults(value: Any, schema: Any = None, where: str = "") -> list[str]:
  """Where a document breaks the schema of `diagnosis.json`, as readable lines; empty if it holds."""
  schema = SCHEMA if schema is None else schema
  if isinstance(schema, str):
    return [] if value is None else faults(value, _OPTIONAL[schema], where)
  if schema is _MAYBE:
    return [] if value is None else faults(value, _NUMBER, where)
  if isinstance(schema, tuple):
    return [] if value in schema else [f"{where}: {value!r} is none of {', '.join(schema)}"]
  if isinstance(schema, list):
    if not isinstance(value, list):
      return [f"{where}: expected a list, got {type(value).__name__}"]
    return [fault for i, item in enumerate(value) for fault in faults(item, schema[0], f"{where}[{i}]")]
  if isinstance(schema, dict):
    return _dict_faults(value, schema, where)
  return _plain_faults(value, schema, where)


def _dict_faults(value: Any, schema: dict[str, Any], where: str) -> list[str]:
  if not isinstance(value, dict):
    return [f"{where}: expected an object, got {type(value).__name__}"]
  if set(schema) == {"*"}:
    return [fault for key, item in value.items() for fault in faults(item, schema["*"], f"{where}.{key}")]
  wrong = [f"{where}.{key}: missing" for key in schema if key not in value]
  wrong += [f"{where}.{key}: not in the schema" for key in value if key not in schema]
  return wrong + [f for key, part in schema.items() if key in value for f in faults(value[key], part, f"{where}.{key}")]


def _plain_faults(value: Any, kind: type, where: str) -> list[str]:
  if kind is float:
    good = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return [] if good else [f"{where}: expected a finite number, got {value!r}"]
  return [] if isinstance(value, kind) else [f"{where}: expected {kind.__name__}, got {type(value).__name__}"]
