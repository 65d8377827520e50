"""Long logs: several sessions of one car, one after the other."""

from __future__ import annotations

import dataclasses

from ..laboratory.written import Session
from .session import Spec, drawn_car, make_sessions


def make_long_session(spec: Spec, count: int) -> Session:
  """So many sessions of one car as one: the vehicle table and the truth are the first one's, further runs carry the
  session's number in their names. Each session begins cold and charged."""
  car = spec.car or drawn_car(spec)
  parts = make_sessions([dataclasses.replace(spec, seed=spec.seed + k, car=car) for k in range(count)])
  recordings, clean = list(parts[0].recordings), dict(parts[0].clean)
  for number, part in enumerate(parts[1:], 2):
    again = lambda name, number=number: f"{name}_{number}"
    recordings += [
      r.replace(name=again(r.name), file=f"{again(r.name)}.csv", session=f"{r.session} {number}")
      for r in part.recordings
    ]
    clean |= {again(name): signals for name, signals in part.clean.items()}
  return dataclasses.replace(parts[0], recordings=tuple(recordings), clean=clean)
