"""Of a long log the stretches are kept that together tell most."""

import numpy as np
import pytest

from calibration.fitting.informative import chosen, regressors


def cruise(speed=1.0, steering=0.0, drive=1.0, change=0.0, length=200):
  time = 0.01 * np.arange(length)
  commands = np.stack([np.full(length, drive), np.full(length, steering)], axis=1)
  return regressors(commands, speed + change * time, np.zeros(length), 0.01, 0.0)


def test_what_was_driven_once_is_kept_before_what_was_driven_often():
  often = [cruise() for _ in range(20)]
  rare = [cruise(steering=0.3), cruise(steering=-0.3), cruise(drive=0.0, change=-0.4), cruise(speed=-0.5, drive=-0.6)]
  stretches = [*often[:7], rare[0], *often[7:12], rare[1], rare[2], *often[12:], rare[3]]
  kept = chosen(stretches, 5)
  assert {7, 13, 14, len(stretches) - 1} <= set(kept.tolist()) and len(kept) == 5
  assert (np.diff(kept) > 0).all()


def test_what_was_kept_for_another_reason_is_not_asked_for_again():
  stretches = [cruise(), cruise(), cruise(steering=0.3), cruise(steering=0.3)]
  assert chosen(stretches, 2, already=[2]).tolist()[-1] == 2 and 3 not in chosen(stretches, 2, already=[2])
  assert chosen(stretches, 9).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_units_of_the_commands_do_not_matter(scale):
  rng = np.random.default_rng(0)
  drives = [(rng.uniform(-2, 2), rng.uniform(-0.4, 0.4), rng.uniform(-2, 2)) for _ in range(30)]
  plain = [cruise(v, s, u) for v, s, u in drives]
  other = [cruise(v, s, scale * u) for v, s, u in drives]
  np.testing.assert_array_equal(chosen(plain, 8), chosen(other, 8))


def test_a_car_that_never_moves_is_no_error():
  still = [cruise(speed=0.0, drive=0.0) for _ in range(5)]
  assert len(chosen(still, 2)) == 2
