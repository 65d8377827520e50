"""Drives that share a simulation: what each gets is what it gets alone."""

import threading

import numpy as np
import pytest

from agents.control.closed_loop import Scenario, drive
from agents.control.model import Model
from agents.control.speed import SpeedGains
from agents.studies.side_by_side import side_by_side
from qcar_twin.estimation.observer import TrueObserver
from qcar_twin.tracks import path_from
from tests.agents.learning.test_train import GOOD

START = np.zeros((2, 7))


class Counted:
  """Cars whose pose_x counts their voltages; keeps what it was asked."""

  period = 0.01

  def __init__(self, fails_at=0):
    self.begun, self.commands, self.fails_at = [], [], fails_at

  def begin(self, theta, start):
    self.begun.append((theta.copy(), start.copy()))
    self.signals = np.zeros((len(start), 10))
    return self

  def step(self, commands):
    self.commands.append(commands.copy())
    if len(self.commands) == self.fails_at:
      raise FloatingPointError("the cars have met")
    self.signals = self.signals.copy()
    self.signals[:, 0] += commands[:, 0]
    return self.signals


def test_drives_of_several_paths_are_what_each_is_alone():
  model = Model.nominal()
  plant, theta = model.plant("bicycle")
  gains = SpeedGains.design(model.car)
  tasks = [Scenario(path_from(name), speed) for name, speed in (("s", 0.9), ("c", 0.9), ("s", 1.5))]
  alone = lambda task: lambda body: drive(body, np.tile(theta, (2, 1)), GOOD, gains, TrueObserver(), task)
  for task, together in zip(tasks, side_by_side(plant, [alone(task) for task in tasks]), strict=True):
    by_itself = alone(task)(plant)
    np.testing.assert_allclose(together.cross_track, by_itself.cross_track, atol=1e-12)
    assert len(together.cross_track) == len(by_itself.cross_track)


def test_cars_of_a_drive_that_is_over_stand_and_the_others_go_on():
  def going(periods, volts):
    def drives(body):
      cars = body.begin(np.full((2, 1), volts), START + volts)
      seen = [cars.step(np.full((2, 2), volts))[0, 0] for _ in range(periods)]
      assert cars.signals.shape == (2, 10)
      return seen

    return drives

  plant = Counted()
  short, long = side_by_side(plant, [going(2, 1.0), going(5, 3.0)])
  assert short == [1.0, 2.0] and long == [3.0, 6.0, 9.0, 12.0, 15.0]
  ((theta, start),) = plant.begun
  assert theta.ravel().tolist() == [1.0, 1.0, 3.0, 3.0] and start[:, 0].tolist() == [1.0, 1.0, 3.0, 3.0]
  assert plant.commands[-1][:, 0].tolist() == [0.0, 0.0, 3.0, 3.0] and len(plant.commands) == 5


def test_the_first_error_ends_all_drives_and_is_raised():
  def endless(body):
    cars = body.begin(np.zeros((2, 0)), START)
    while True:
      cars.step(np.zeros((2, 2)))

  def wrong(body):
    body.begin(np.zeros((2, 0)), START)
    raise KeyError("no such path")

  before = threading.active_count()
  for plant, second, error in ((Counted(), wrong, KeyError), (Counted(fails_at=3), endless, FloatingPointError)):
    with pytest.raises(error):
      side_by_side(plant, [endless, second, endless])
  assert side_by_side(Counted(), []) == []
  assert threading.active_count() <= before
