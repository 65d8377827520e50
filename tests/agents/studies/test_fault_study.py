"""The drives on which the filter is given faulty sensors."""

import numpy as np

from agents.control.controllers import load
from agents.control.model import Model
from agents.studies import fault_study
from qcar_twin.plant import VELOCITY


def test_the_speed_swings_or_a_frozen_encoder_would_be_right(monkeypatch):
  monkeypatch.setattr(fault_study, "SECONDS", 5.5)
  model = Model.nominal()
  driven = fault_study.record(model, "bicycle", load(model.car)["lq_cm", "tuned"], "infinity", 1, seed=1)
  speed = np.hypot(*driven.signals[..., VELOCITY].T)
  assert speed.max() > fault_study.SPEED + 0.8 * fault_study.SWING
  assert speed.min() < fault_study.SPEED - 0.8 * fault_study.SWING
