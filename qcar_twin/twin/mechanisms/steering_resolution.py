"""Steering servo that knows only some angles."""

from collections.abc import Mapping, Sequence

import numpy as np

from qcar_twin.parameters import Parameter
from qcar_twin.plant import Driving
from qcar_twin.twin.mechanisms.base import Array, Context, Mechanism, State

_EDGE = 0.9  # ratio of the series: nine tenths of the rounding's first harmonic
_COARSEST, _RATIO = 0.16, 1.13  # rad and -, steps that are tried: over seven of them a fit sees the next


class SteeringResolution(Mechanism):
  """The servo, or what tells it, rounds angles to whole steps.

  Equation: delta = u - a s / pi atan2(q sin x, 1 + q cos x), x = 2 pi u / s, q = 0.9: rounding with edges that a fit
    can follow; q = 1 is rounding itself.
  Units: a -, share of it, 1 all; s rad, the step.
  Source: Widrow and Kollar, Quantization Noise, Cambridge, 2008, ch. 1; Gradshteyn and Ryzhik, Table of Integrals,
    Series, and Products, 7th ed., 2007, 1.448 (the sawtooth's series).
  Size: stated prior: 0.6 is more than half of rounding, which is there or is not; the step of 0.035 rad is 25 angles
    over 50 deg of steering.
  Confounded with: steering_quantisation, which has no fixed angles; steering_dead_zone about straight ahead.
  """

  name = "steering_resolution"
  subsystem = "steering"
  stage = "command"
  link = "arrival"
  open_loop = True
  whole = ("steering_resolution",)
  parameters = (
    Parameter("steering_resolution", 0.0, 0.0, 1.0, "-", "a", null=0.0, typical=0.6, description="share of rounding"),
    Parameter("steering_resolution_step", 0.035, 0.015, 0.2, "rad", "s", description="from one angle to the next"),
  )

  def initial_guesses(self, driving: Driving) -> Sequence[Mapping[str, float]]:
    """Steps close to each other: one that is a little off puts the last angles elsewhere."""
    lower = self.parameters[1].lower
    count = int(np.log(_COARSEST / lower) / np.log(_RATIO)) + 1
    return tuple({"steering_resolution_step": float(lower * _RATIO**k)} for k in range(count))

  def command(self, theta: Array, context: Context, state: State, command: Array) -> Array:
    acting = command.copy()
    share, step = theta[:, 0], theta[:, 1]
    turn = 2.0 * np.pi * command[:, 1] / step
    acting[:, 1] -= share * step / np.pi * np.arctan2(_EDGE * np.sin(turn), 1.0 + _EDGE * np.cos(turn))
    return acting
