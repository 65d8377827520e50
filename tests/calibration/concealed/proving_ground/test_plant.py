"""The independent car as a plant for controllers and the seal."""

import json

import numpy as np
import pytest

from calibration.concealed.laboratory.seal import COMMITMENT, PACKED, PLAIN, SealError, commitment, seal, unseal
from calibration.concealed.proving_ground import Car, ProvingGroundPlant
from tests import ROOT

TRUTH = {"effects": [{"id": "payload", "size": 1.0}], "seed": 4}


def test_signals_stand_in_the_order_of_the_plants():
  run = ProvingGroundPlant().begin(np.array([[1.0, 2.0, 0.3, 0.9, 0.0, 0.0, 0.05]]))
  rolling = 0.9 * (0.5 + 0.5 * np.cos(0.05))  # front wheels along their headings, and rear ones
  assert run.signals[0] == pytest.approx(
    [1.0, 2.0, 0.3, 0.9, 0.0, 0.0, *run.signals[0, 6:8], rolling / 0.033 / Car().gear_ratio, 0.05]
  )


def test_a_proportional_controller_follows_a_line():
  run = ProvingGroundPlant(noise=1.0, seed=3).begin(np.array([[0, 0.2, 0, 0.5, 0, 0, 0], [0, -0.2, 0, 0.5, 0, 0, 0.0]]))
  for _ in range(500):
    s = run.signals
    steer = np.clip(-1.5 * s[:, 1] - 1.2 * s[:, 2], -0.5, 0.5)
    run.step(np.stack([0.7 + 1.5 * (0.5 - s[:, 3]), steer], axis=1))
  assert np.abs(run.signals[:, 1]).max() < 0.02
  assert run.signals[:, 3] == pytest.approx(0.5, abs=0.1)


def test_a_seed_reproduces_a_noisy_drive():
  ends = []
  for _ in range(2):
    run = ProvingGroundPlant(noise=1.0, seed=3).begin(np.zeros((2, 7)))
    for _ in range(30):
      run.step(np.array([[1.0, 0.1], [1.0, -0.1]]))
    ends.append(run.signals)
  assert np.array_equal(*ends)
  assert ends[0][0, 1] != -ends[0][1, 1]  # each car has its own noise


def test_effects_act_in_the_plant():
  bare, hidden = (ProvingGroundPlant(effects=e).begin(np.zeros((1, 7))) for e in ((), (("drive_delay", 1.0),)))
  for run in (bare, hidden):
    for _ in range(20):
      run.step(np.array([[1.5, 0.0]]))
  assert hidden.signals[0, 3] < 0.9 * bare.signals[0, 3]


@pytest.mark.parametrize(("start", "commands"), [((1, 6), (1, 2)), ((2, 7), (2, 3)), ((2, 7), (1, 2))])
def test_wrong_shapes_are_refused(start, commands):
  with pytest.raises(ValueError, match=r"must be \("):
    ProvingGroundPlant().begin(np.zeros(start)).step(np.zeros(commands))


def test_an_unknown_effect_is_refused_at_once():
  with pytest.raises(KeyError, match="did you mean 'drive_lag'"):
    ProvingGroundPlant(effects=(("drive_lagg", 1.0),))


@pytest.mark.parametrize("packed", [False, True])
def test_what_is_sealed_is_what_is_unsealed(tmp_path, packed):
  mark = seal(TRUTH, tmp_path / "data", tmp_path / "truth", packed)
  assert (tmp_path / "data" / COMMITMENT).read_text().strip() == mark
  assert unseal(tmp_path / "truth", mark) == TRUTH
  assert [file.name for file in (tmp_path / "data").iterdir()] == [COMMITMENT]


def test_a_packed_truth_does_not_show_its_words(tmp_path):
  seal(TRUTH, tmp_path / "data", tmp_path / "truth", packed=True)
  assert "payload" not in (tmp_path / "truth" / PACKED).read_text()


def test_the_commitment_needs_the_salt(tmp_path):
  marks = {seal(TRUTH, tmp_path / f"data{i}", tmp_path / f"truth{i}") for i in range(2)}
  assert len(marks) == 2
  assert commitment(b"a", b"bc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_a_changed_truth_is_found_out(tmp_path):
  mark = seal(TRUTH, tmp_path / "data", tmp_path / "truth")
  file = tmp_path / "truth" / PLAIN
  file.write_text(file.read_text().replace("payload", "cogging"))
  with pytest.raises(SealError, match="not the truth that was committed to"):
    unseal(tmp_path / "truth", mark)


def test_another_sessions_truth_is_found_out(tmp_path):
  seal(TRUTH, tmp_path / "data", tmp_path / "truth")
  with pytest.raises(SealError, match="not the truth"):
    unseal(tmp_path / "truth", "0" * 64)


def test_the_truth_may_not_lie_with_the_data(tmp_path):
  for inside in (tmp_path, tmp_path / "deep" / "er"):
    with pytest.raises(SealError, match="must not lie with the data"):
      seal(TRUTH, tmp_path, inside)


def test_a_missing_truth_says_where_to_look(tmp_path):
  with pytest.raises(SealError, match="--truth-out"):
    unseal(tmp_path)


def test_the_bundled_sample_keeps_its_commitment():
  sample = ROOT / "data" / "sample"
  mark = (sample / COMMITMENT).read_text().strip()
  assert mark in (sample / "dataset.toml").read_text()
  assert json.loads((ROOT / "data" / "sample_truth" / PACKED).read_text())["sha256"] == mark
  truth = unseal(ROOT / "data" / "sample_truth", mark)
  assert len(truth["effects"]) == 1 and truth["effects"][0]["in_catalogue"]
  assert sum(file.stat().st_size for file in sample.iterdir()) < 6e6
