"""`characterise` on a small session whose car turns less than it is told, the more the larger the angle."""

import json

import pytest

from calibration.characterise.study import KINDS
from commands import characterise
from qcar_twin.twin.file import load_twin
from tests.commands.tiny_session import write

CONCEALED = {"steering_nonlinearity": {"steering_nonlinearity": 0.3, "steering_nonlinearity_power": 1.0}}


@pytest.fixture(scope="module")
def done(tmp_path_factory):
  folder = tmp_path_factory.mktemp("characterised")
  write(folder / "data", CONCEALED)
  config = characterise.Config(folder / "data", folder / "out", threads=2)
  return characterise.main(config), folder / "out"


def test_the_curve_is_the_one_that_was_concealed(done):
  found, _ = done
  steering = next(o for o in found.outlines if o.curve == "steering_curve")
  reach = found.found.twin.parameters.named(found.found.theta)["steering_curve_reach"]
  assert reach == pytest.approx(0.2, rel=0.05)
  lost = -0.3 * reach / found.found.twin.vehicle.max_steering  # at the largest command, in shares of it
  assert steering.heights[-1] == pytest.approx(lost, abs=3.0 * steering.std[-1])


def test_what_judges_gets_better_and_every_reference_is_there(done):
  found, _ = done
  assert set(found.errors) <= set(KINDS) and {"base", "characterised", "black_box", "noise"} <= set(found.errors)
  assert found.gain > 0.03  # by validation; twenty seconds of driving do not carry to the harder turns of the hold-out


def test_what_is_written_is_whole(done):
  found, out = done
  document = json.loads((out / "characterise.json").read_text())
  assert [c["curve"] for c in document["curves"]] == [o.curve for o in found.outlines]
  twin, theta = load_twin(out / "twin.toml")
  shipped, kept = found.shipped
  better = found.found.twin if document["validation_gain"] >= 0.0 else found.base.problem.twin
  assert shipped.engine == "mujoco" and shipped.parameters.names == better.parameters.names
  values, expected = twin.parameters.named(theta), shipped.parameters.named(kept)
  for name in twin.parameters.names:
    assert values[name] == pytest.approx(expected[name])
