"""Commands that make a session and open its truth."""

import json

import pytest

from calibration.concealed.laboratory.designs import DESIGNS
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from scripts import estimate, make_session, unseal
from tests import ROOT
from tests.scripts.short_design import short


@pytest.fixture(scope="module")
def session(tmp_path_factory):
  """A quick session with one effect at half its typical size, and where it lies."""
  folder = tmp_path_factory.mktemp("session")
  config = make_session.Config(
    folder / "data", seed=5, effect=("steering_offset",), size=(0.5,), packed=True, quick=True, clean=True
  )
  with pytest.MonkeyPatch.context() as patch:
    patch.setitem(DESIGNS, "compact", short)
    return make_session.main(config), folder


def test_make_session_writes_a_data_set_that_loads(session):
  data, folder = session
  assert data.warnings == ()
  assert {r.role for r in data.recordings} == {"identify", "validate", "holdout"}
  assert {"voltage_step", "circle"} <= {r.manoeuvre for r in data.recordings}
  again = DataSet.load(folder / "data")
  assert [r.name for r in again.recordings] == [r.name for r in data.recordings]
  assert (folder / "data_truth" / "clean.npz").is_file()


def test_the_truth_is_told_only_by_the_sealed_file(session, capsys):
  _, folder = session
  told = [p for p in folder.rglob("*") if p.is_file() and b"steering_offset" in p.read_bytes()]
  assert told == []
  truth = unseal.main(unseal.Config(folder / "data_truth", folder / "data"))
  assert json.loads(capsys.readouterr().out) == truth
  assert "steering_offset" in json.dumps(truth)


def test_make_session_wants_an_effect_for_every_size(tmp_path):
  with pytest.raises(ValueError, match="2 sizes for 1 effects: give each --size after its --effect"):
    make_session.main(make_session.Config(tmp_path / "data", effect=("payload",), size=(1.0, 2.0)))
  assert not (tmp_path / "data").exists()


def test_make_session_knows_the_second_car(tmp_path, capsys):
  assert make_session.main(make_session.Config(tmp_path / "data", car="second", effect=("list",))) is None
  told = capsys.readouterr().out
  assert "steering_delay" in told
  assert "cogging" not in told  # an effect of the first car
  with pytest.raises(ValueError, match="one session at a time, not 2"):
    make_session.main(make_session.Config(tmp_path / "data", car="second", sessions=2))
  with pytest.raises(KeyError, match="no effect 'cogging'"):
    make_session.main(make_session.Config(tmp_path / "data", car="second", effect=("cogging",), quick=True))


def test_make_session_lists_the_effects(tmp_path, capsys):
  assert make_session.main(make_session.Config(tmp_path / "data", effect=("list",))) is None
  lines = capsys.readouterr().out.splitlines()
  assert len(lines) > 25 and any(line.startswith("battery_sag ") for line in lines)


@pytest.mark.parametrize(("layout", "share"), [("all-wheel", 0.5), ("rear", 0.0)])
def test_estimate_knows_which_wheels_the_encoder_sees(tmp_path, layout, share):
  config = estimate.Config(ROOT / "data" / "sample", tmp_path)
  settings = estimate.settings_of(config, DataSet.load(config.dataset), Vehicle(layout=layout))
  assert settings.front_drive_share == share


@pytest.mark.parametrize(("shift", "delays"), [(0, (0, 3)), (1, (1, 4)), (-1, (0, 2))])
def test_estimate_takes_over_when_the_twins_commands_act(tmp_path, shift, delays):
  twin = Twin(Vehicle(), select(["steering_delay"]), threads=1)
  save_twin(tmp_path / "twin.toml", twin, twin.parameters.vector({"steering_delay": 0.03}), command_shift=shift)
  config = estimate.Config(ROOT / "data" / "sample", tmp_path, twin=tmp_path / "twin.toml")
  assert estimate.settings_of(config, DataSet.load(config.dataset), Vehicle()).delays == delays
