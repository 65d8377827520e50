"""Policies as files: round trip, equality of the export, clear errors, and the same numbers as the trained network."""

import dataclasses
import json

import numpy as np
import onnx
import pytest
from safetensors.numpy import load_file, save_file

from agents.learning import policy_file
from agents.learning.ddpg import Settings, actor_layers, make_agent
from agents.learning.environments import Options, fleet
from agents.learning.policy_file import Policy, export_onnx, load_policy, onnx_difference, save_policy
from qcar_twin.envs.vector_env import FleetVecEnv

RNG = np.random.default_rng(0)
SHAPES = ((200, 4), (200, 200), (1, 200))
LAYERS = tuple(
  ((RNG.standard_normal(s) / np.sqrt(s[1])).astype(np.float32), 0.1 * RNG.standard_normal(s[0]).astype(np.float32))
  for s in SHAPES
)
POLICY = Policy(LAYERS, (20.0, 5.0, 5.0, 1.0), provenance={"training": {"seed": 3}})
OBSERVATIONS = 0.1 * RNG.standard_normal((50, 4))


def test_round_trip(tmp_path):
  save_policy(POLICY, tmp_path)
  again = load_policy(tmp_path)
  np.testing.assert_array_equal(again.rate(OBSERVATIONS), POLICY.rate(OBSERVATIONS))
  assert dataclasses.replace(again, layers=()) == dataclasses.replace(POLICY, layers=())
  assert sorted(p.name for p in tmp_path.iterdir()) == ["policy.json", "policy.safetensors"]


def test_a_policy_acts_like_the_network_it_was_taken_from():
  agent = make_agent(FleetVecEnv(fleet(Options(plant="bicycle", estimator="truth"), range(8))), Settings(), 0)
  policy = Policy(tuple(actor_layers(agent)), Settings().observation_scale)
  predicted, _ = agent.predict(OBSERVATIONS.astype(np.float32), deterministic=True)
  np.testing.assert_allclose(policy.rate(OBSERVATIONS), predicted[:, 0], atol=2e-6)


def test_rate_is_bounded_and_zero_for_a_zero_network():
  zero = Policy(tuple((0.0 * w, 0.0 * b) for w, b in LAYERS), POLICY.observation_scale)
  assert np.all(zero.rate(OBSERVATIONS) == 0.0)
  assert np.abs(POLICY.rate(1e3 * OBSERVATIONS)).max() <= 1.5


def test_export_acts_the_same_in_si_units(tmp_path):
  file = tmp_path / "new" / "policy.onnx"
  assert export_onnx(POLICY, file) < 1e-5
  assert onnx_difference(POLICY, file, seed=5) < 1e-5
  assert [p.name for p in file.parent.iterdir()] == ["policy.onnx"]
  graph = onnx.load(str(file)).graph
  assert [x.name for x in graph.input] == ["observation"] and [x.name for x in graph.output] == ["steering_rate"]


def test_an_export_that_differs_is_refused_and_leaves_nothing(tmp_path, monkeypatch):
  other = dataclasses.replace(POLICY, largest_rate=1.4)
  real = policy_file._graph
  monkeypatch.setattr(policy_file, "_graph", lambda policy: real(other))
  with pytest.raises(RuntimeError, match="differs by"):
    export_onnx(POLICY, tmp_path / "policy.onnx")
  assert not list(tmp_path.iterdir())


def test_files_that_are_missing_or_do_not_fit_are_named(tmp_path):
  with pytest.raises(FileNotFoundError, match=r"policy\.safetensors.*qcar-twin train"):
    load_policy(tmp_path)
  save_policy(POLICY, tmp_path)
  tensors = load_file(tmp_path / "policy.safetensors")
  tensors.pop("bias_1")
  save_file(tensors, tmp_path / "policy.safetensors")
  with pytest.raises(ValueError, match="bias_1 is missing"):
    load_policy(tmp_path)
  about = json.loads((tmp_path / "policy.json").read_text())
  (tmp_path / "policy.json").write_text(json.dumps(about | {"format": 0}))
  with pytest.raises(ValueError, match="format 1"):
    load_policy(tmp_path)


def test_nothing_in_a_policy_can_be_executed(tmp_path):
  """safetensors is a JSON header and raw numbers; torch's own format would be a zip of pickles."""
  save_policy(POLICY, tmp_path)
  head = (tmp_path / "policy.safetensors").read_bytes()
  size = int.from_bytes(head[:8], "little")
  assert set(json.loads(head[8 : 8 + size])) == {f"{kind}_{k}" for kind in ("weight", "bias") for k in range(3)}
