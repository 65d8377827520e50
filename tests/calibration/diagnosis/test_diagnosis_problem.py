"""The problem's simulations: MuJoCo's warnings about trials that fly apart."""

import logging

import mujoco
import numpy as np
import pytest

from calibration.diagnosis.problem import warnings_logged

BALL = '<mujoco><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'


def fly_apart():
  model = mujoco.MjModel.from_xml_string(BALL)
  data = mujoco.MjData(model)
  data.qvel[0] = np.nan
  mujoco.mj_step(model, data)


def test_a_simulation_that_flies_apart_is_logged_and_not_printed(capfd, caplog, tmp_path, monkeypatch):
  monkeypatch.chdir(tmp_path)
  with caplog.at_level(logging.DEBUG), warnings_logged():
    fly_apart()
  assert "unstable" in caplog.text
  assert capfd.readouterr() == ("", "") and list(tmp_path.iterdir()) == []


def test_what_listened_before_listens_again():
  heard = []
  mujoco.set_mju_user_warning(heard.append)
  try:
    with pytest.raises(KeyError), warnings_logged():
      raise KeyError
    fly_apart()
  finally:
    mujoco.set_mju_user_warning(None)
  assert len(heard) == 1 and "unstable" in heard[0]
