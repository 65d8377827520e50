"""A trained policy as data: weights in safetensors, the rest in JSON, export to ONNX. Nothing in it can be executed.

policy.safetensors: `weight_k` (out, in) and `bias_k` (out,) of layer k, float32.
policy.json: what is seen and its scale, bounds, and where the policy comes from.
"""

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.control.interface import Situation
from agents.learning.observation import ObservationSpec
from qcar_twin.atomic_io import whole_file, write_text
from qcar_twin.extras import extra
from qcar_twin.slow_means import MEMORY
from qcar_twin.untrusted import UnreadableFile, bounded_memory, is_number, read_json
from qcar_twin.vehicle.vehicle import QCAR

with extra("Reading a policy"):
  from safetensors import SafetensorError
  from safetensors.numpy import load_file, save_file

Array = NDArray[np.float64]
Layers = tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
FORMAT = 1
MOST_LAYERS = 100
HIDDEN, BOUNDS, LIMITED = ("relu", "tanh"), ("tanh", "clip"), "observation_limit"
WEIGHTS, DESCRIPTION, ONNX = "policy.safetensors", "policy.json", "policy.onnx"
SHIPPED = Path(__file__).resolve().parents[1] / "data" / "policy"  # the agent that comes with the package
IMITATION = SHIPPED.with_name("imitation")  # the policy that imitates a teacher that sees the truth


@dataclasses.dataclass(frozen=True)
class Policy:
  """A bounded network from errors to steering rate, as a controller.

  Attributes:
    layers: weights (out, in) and biases (out,).
    observation_scale: (n,), 1/m, s/m, 1/rad, s/rad for the four errors, then of what else is seen.
    largest_rate: bound of the steering rate, rad/s.  lock: of the steering angle it integrates, rad.
    provenance: how it was trained, with its indicators.
    name: how it was trained: "ddpg", "td3", "sac", "ppo", or "imitation".
    observation: what is seen.
    hidden: of the layers but the last, "relu" or "tanh".
    bound: of the last: "tanh", or "clip" to +-1.
    observation_limit: a scaled observation is held within +- this.
  """

  layers: Layers
  observation_scale: tuple[float, ...]
  largest_rate: float = 1.5
  lock: float = QCAR.max_steering
  provenance: Mapping[str, Any] = dataclasses.field(default_factory=dict)
  name: str = "policy"
  observation: ObservationSpec = ObservationSpec()
  hidden: str = "relu"
  bound: str = "tanh"
  observation_limit: float = math.inf

  @property
  def updates(self) -> int | None:
    """Gradient steps by reward that made it; None where its file does not say."""
    result = self.provenance.get("result")
    count = result.get("updates") if isinstance(result, dict) else None
    return count if isinstance(count, int) else None

  @property
  def about(self) -> str:
    """What it is, in a line."""
    teacher = "imitation of a teacher, " if self.name == "imitation" else ""
    learnt = {None: "number of updates by reward unknown", 0: f"{teacher}no update by reward"}
    said = learnt.get(self.updates, f"{self.updates} updates by reward")
    return f"{self.name}: {said}; sees {len(self.observation.names)} numbers"

  def rate(self, observation: Array) -> Array:
    """Steering rate, rad/s, (N,), for observations in SI units, (N, n); single precision inside, as trained."""
    x = observation.astype(np.float32) * np.asarray(self.observation_scale, dtype=np.float32)
    x = np.clip(x, -self.observation_limit, self.observation_limit).astype(np.float32)
    for weight, bias in self.layers[:-1]:
      x = x @ weight.T + bias
      x = np.maximum(x, 0.0) if self.hidden == "relu" else np.tanh(x)
    weight, bias = self.layers[-1]
    x = (x @ weight.T + bias)[:, 0].astype(np.float64)
    return self.largest_rate * (np.tanh(x) if self.bound == "tanh" else np.clip(x, -1.0, 1.0))

  def steer(self, situation: Situation) -> Array:
    """Steering command: the last one moved on by the rate."""
    errors, path, arc_length = situation.errors.observation, situation.path, situation.arc_length
    steering, speed = situation.steering, situation.speed
    seen = self.observation.look(errors, steering, situation.past, path, arc_length, situation.recent, speed)
    return np.clip(steering + self.rate(seen) * situation.period, -self.lock, self.lock)


def save_policy(policy: Policy, folder: Path) -> None:
  """Write policy.safetensors and policy.json, each replaced as a whole."""
  tensors = {}
  for k, (weight, bias) in enumerate(policy.layers):
    tensors[f"weight_{k}"], tensors[f"bias_{k}"] = np.ascontiguousarray(weight), np.ascontiguousarray(bias)
  with whole_file(folder / WEIGHTS) as part:
    save_file(tensors, part)
    part.chmod(0o644)  # the library writes for the owner alone
  about = {
    "format": FORMAT,
    "kind": policy.name,
    "layers": len(policy.layers),
    "observation": list(policy.observation.names),
    "observation_scale": list(policy.observation_scale),
    "action": "steering rate rad/s",
    "largest_rate": policy.largest_rate,
    "lock": policy.lock,
    "sight": dataclasses.asdict(policy.observation),
    "hidden": policy.hidden,
    "bound": policy.bound,
    "observation_limit": policy.observation_limit if math.isfinite(policy.observation_limit) else None,
    "provenance": dict(policy.provenance),
  }
  write_text(folder / DESCRIPTION, json.dumps(about, indent=1, default=str) + "\n")


def load_policy(folder: Path) -> Policy:
  """Read what `save_policy` wrote.

  Raises:
    FileNotFoundError, ValueError: with the file's name and the cure.
  """
  for name in (WEIGHTS, DESCRIPTION):
    if not (folder / name).is_file():
      raise FileNotFoundError(f"{folder / name}: no such file; a policy folder is made by qcar-twin train")
  about, where = read_json(folder / DESCRIPTION), folder / DESCRIPTION
  if about.get("format") != FORMAT:
    raise UnreadableFile(f"{where}: not a policy of format {FORMAT}; train it again with qcar-twin train")
  wrong = [name for name in ("largest_rate", "lock") if not (is_number(about.get(name)) and about[name] > 0.0)]
  scale = about.get("observation_scale")
  if wrong or not isinstance(scale, list) or not all(map(is_number, scale)):
    named = wrong[0] if wrong else "observation_scale"
    raise UnreadableFile(f"{where}: {named} must be finite and there; train the policy again")
  try:
    seen = observation_from(about.get("sight", {}))
  except (AttributeError, TypeError, ValueError) as error:
    raise UnreadableFile(f"{where}: sight is not that of a policy ({error}); train it again") from error
  layers = _layers(folder / WEIGHTS, about.get("layers"), [len(scale), seen.size])
  history, kind = about.get("provenance"), about.get("kind")
  if not isinstance(history, dict) or not isinstance(kind, str):
    raise UnreadableFile(f"{where}: kind or provenance is missing; train the policy again")
  scales, rate, lock = tuple(map(float, scale)), float(about["largest_rate"]), float(about["lock"])
  hidden, bound, limit = about.get("hidden", "relu"), about.get("bound", "tanh"), about.get(LIMITED)
  if hidden not in HIDDEN or bound not in BOUNDS or not (limit is None or (is_number(limit) and limit > 0.0)):
    raise UnreadableFile(f"{where}: hidden, bound or {LIMITED} is not that of a policy; train it again")
  limit = math.inf if limit is None else float(limit)
  policy = Policy(layers, scales, rate, lock, history, kind, seen, hidden, bound, limit)
  with np.errstate(all="ignore"):
    rates = policy.rate(np.stack([np.zeros(seen.size), np.ones(seen.size), -np.ones(seen.size)]))
  if not np.isfinite(rates).all():
    raise UnreadableFile(f"{where}: its numbers are too large for single precision; train the policy again")
  return policy


def _layers(file: Path, count: object, inputs: Sequence[int]) -> Layers:
  """The network's weights and biases, checked to be finite and to fit each other and what is seen."""
  try:
    with bounded_memory(file.stat().st_size):
      tensors = load_file(file)
  except (SafetensorError, MemoryError, ValueError, TypeError, KeyError) as error:
    raise UnreadableFile(f"{file}: is not a readable safetensors file ({error}); train the policy again") from error
  layers, apart = [], "the two files do not belong together; take both from one training"
  for k in range(count if isinstance(count, int) and 0 < count <= MOST_LAYERS else 0):
    if missing := [name for name in (f"weight_{k}", f"bias_{k}") if name not in tensors]:
      raise UnreadableFile(f"{file}: {missing[0]} is missing; {apart}")
    weight, bias = tensors[f"weight_{k}"], tensors[f"bias_{k}"]
    if weight.ndim != 2 or bias.shape != weight.shape[:1] or {weight.shape[1]} != set(inputs):
      shapes = f"{weight.shape} and {bias.shape}"
      raise UnreadableFile(f"{file}: layer {k} of {shapes} does not fit {inputs} inputs; {apart}")
    if not (weight.dtype == bias.dtype == np.float32 and np.isfinite(weight).all() and np.isfinite(bias).all()):
      raise UnreadableFile(f"{file}: layer {k} holds what is no finite float32; train the policy again")
    layers.append((weight, bias))
    inputs = [weight.shape[0]]
  if inputs != [1]:
    raise UnreadableFile(f"{file}: has no network of {count!r:.20} layers with one output; {apart}")
  return tuple(layers)


def observation_from(table: Mapping[str, Any]) -> ObservationSpec:
  """What is seen, from its JSON; the paper's agent's where a file says nothing. Raises ValueError: it is none."""
  previews, history = (tuple(float(x) for x in table.get(name, ())) for name in ("previews", "history"))
  if not all(0.0 <= lag <= MEMORY for lag in history):
    raise ValueError(f"a look back of more than {MEMORY:g} s")
  steering, past, speed = (bool(table.get(name, False)) for name in ("steering", "past", "speed"))
  return ObservationSpec(steering, previews, past, history, speed)


def export_onnx(policy: Policy, file: Path, tolerance: float = 1e-5) -> float:
  """Write the policy as ONNX, `observation` (N, n) -> `steering_rate` (N, 1), and check that it acts the same.

  Returns:
    Largest difference over 1000 observations, rad/s.

  Raises:
    RuntimeError: it acts differently by more than `tolerance`; nothing is left behind then.
  """
  with extra("Exporting a policy as ONNX"):
    import onnx

  with whole_file(file) as part:
    onnx.save(_graph(policy), str(part))
    worst = onnx_difference(policy, part)
    if not worst <= tolerance:
      raise RuntimeError(f"{file.name}: the exported policy differs by {worst:.3g} rad/s")
  return worst


def onnx_difference(policy: Policy, file: Path, seed: int = 0) -> float:
  """Largest difference in steering rate, rad/s, between a policy and an ONNX file, over 1000 observations."""
  with extra("Checking an exported policy"):
    import onnxruntime

  size = np.array([0.1, 0.3, 0.3, 1.0, *[1.0 / scale for scale in policy.observation.scale]])
  observation = size * np.random.default_rng(seed).standard_normal((1000, len(size)))
  session = onnxruntime.InferenceSession(file.read_bytes(), providers=["CPUExecutionProvider"])
  (rate,) = session.run(None, {"observation": observation.astype(np.float32)})
  return float(np.max(np.abs(np.asarray(rate)[:, 0] - policy.rate(observation))))


def _graph(policy: Policy):
  """The network as an ONNX model."""
  with extra("Exporting a policy as ONNX"):
    from onnx import TensorProto, checker, helper, numpy_helper

  scale = np.asarray(policy.observation_scale, dtype=np.float32)
  weights = [numpy_helper.from_array(scale, "scale")]
  weights.append(numpy_helper.from_array(np.asarray(policy.largest_rate, np.float32), "largest_rate"))
  nodes = [helper.make_node("Mul", ["observation", "scale"], ["scaled"])]
  seen = "scaled"
  if math.isfinite(policy.observation_limit):
    weights += _edges("seen", policy.observation_limit, numpy_helper)
    nodes.append(helper.make_node("Clip", [seen, "seen_low", "seen_high"], ["x0"]))
    seen = "x0"
  kinds = {"relu": "Relu", "tanh": "Tanh"}
  for k, (weight, bias) in enumerate(policy.layers):
    weights += [
      numpy_helper.from_array(weight.copy(), f"weight_{k}"),
      numpy_helper.from_array(bias.copy(), f"bias_{k}"),
    ]
    nodes.append(helper.make_node("Gemm", [seen, f"weight_{k}", f"bias_{k}"], [f"y{k}"], transB=1))
    seen = f"x{k + 1}"
    if k < len(policy.layers) - 1 or policy.bound == "tanh":
      kind = kinds[policy.hidden] if k < len(policy.layers) - 1 else "Tanh"
      nodes.append(helper.make_node(kind, [f"y{k}"], [seen]))
    else:
      weights += _edges("rate", 1.0, numpy_helper)
      nodes.append(helper.make_node("Clip", [f"y{k}", "rate_low", "rate_high"], [seen]))
  nodes.append(helper.make_node("Mul", [seen, "largest_rate"], ["steering_rate"]))
  inputs = [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["cars", policy.observation.size])]
  outputs = [helper.make_tensor_value_info("steering_rate", TensorProto.FLOAT, ["cars", 1])]
  graph = helper.make_graph(nodes, "policy", inputs, outputs, weights)
  model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
  checker.check_model(model)
  return model


def _edges(name: str, limit: float, numpy_helper) -> list:
  """The constants of a Clip to +-limit."""
  sides = (("low", -limit), ("high", limit))
  return [numpy_helper.from_array(np.asarray(value, np.float32), f"{name}_{side}") for side, value in sides]
