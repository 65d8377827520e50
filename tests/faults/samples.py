"""A good file of every kind that this project reads, and its reader."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.compute  # what readers load late is loaded here, once for all forked readers
import pyarrow.csv
import pyarrow.dataset
import pyarrow.parquet
import scipy.io
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores

from agents.control import controllers
from agents.control.model import Model
from agents.learning.policy_file import Policy, load_policy, save_policy
from calibration.concealed.campaign.archive import digest, keep, pack, unpack
from calibration.concealed.laboratory.seal import seal, unseal
from calibration.identification.identification import Identification, identify
from qcar_twin.recordings.dataset import DataSet
from qcar_twin.twin.file import load_twin, save_twin
from qcar_twin.twin.mechanisms import select
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import QCAR, Vehicle
from tests import ROOT
from tests.qcar_twin.recordings.drives import drive, write_csv, write_manifest
from tests.qcar_twin.recordings.formats.test_rosbag import CHANNELS, Messages, write_ros1, write_ros2

SECONDS = 1.0  # of driving in a log


@dataclasses.dataclass(frozen=True)
class Kind:
  """A kind of file.

  Attributes:
    make: writes a good one into a folder; returns the files that can be damaged, relative to it.
    read: reads what lies in the folder; returns numbers that must be finite.
    text: whether a person could write it.
  """

  make: Callable[[Path], list[str]]
  read: Callable[[Path], object]
  text: bool = False


def _streams(folder: Path) -> list[np.ndarray]:
  data = DataSet.load(folder)
  return [array for r in data.recordings for s in r.streams.values() for array in (s.time, s.value)]


def _log(name: str, write: Callable[[Path, dict[str, np.ndarray]], object], channels: str = ""):
  def make(folder: Path) -> list[str]:
    time, columns = drive(SECONDS)
    write(folder / name, {"time": time, **columns})
    write_manifest(folder, (name,), channels=channels)
    return [name]

  return make


def _csv(path: Path, columns: dict[str, np.ndarray]) -> None:
  write_csv(path, columns["time"], {name: column for name, column in columns.items() if name != "time"})


def _parquet(path: Path, columns: dict[str, np.ndarray]) -> None:
  pyarrow.parquet.write_table(pyarrow.table(columns), path)


def _npz(path: Path, columns: dict[str, np.ndarray]) -> None:
  np.savez_compressed(path, allow_pickle=False, **columns)


def _mat(path: Path, columns: dict[str, np.ndarray]) -> None:
  scipy.io.savemat(path, {"log": dict(columns), **columns}, do_compression=False)


ROWS = range(60)


def _bag(folder: Path, plugin: StoragePlugin, name: str) -> list[str]:
  written = write_ros2(folder / "drive", plugin, Messages(Stores.ROS2_HUMBLE), rows=ROWS)
  write_manifest(folder, (name,), channels=CHANNELS)
  files = [str(path.relative_to(folder)) for path in sorted(written.iterdir())]
  if name == "drive":
    return files
  next(written.glob("*.mcap")).rename(folder / name)
  (written / "metadata.yaml").unlink()
  written.rmdir()
  return [name]


def _ros1(folder: Path) -> list[str]:
  write_ros1(folder / "drive.bag")
  write_manifest(folder, ("drive.bag",), channels=CHANNELS)
  return ["drive.bag"]


def _manifest(folder: Path) -> list[str]:
  time, columns = drive(SECONDS)
  write_csv(folder / "run.csv", time, columns)
  top = 'name = "lab"\ncommand_timing = "unknown"\nlicence = "MIT"'
  channels = 'accel_x = { column = "accel_x", scale = 1.0, offset = 0.0 }\npose_yaw = { column = "pose_yaw" }'
  write_manifest(folder, top=top, channels=channels, extra='manoeuvre = "free"\nsession = "one"\nfrom = 0.1\nto = 0.9')
  return ["dataset.toml"]


def _twin(folder: Path) -> list[str]:
  twin = Twin(QCAR, select(["steering_offset", "battery_sag"]), threads=1)
  values = {p.name: 0.5 * p.upper for mechanism in twin.mechanisms for p in mechanism.parameters}
  theta = twin.parameters.vector(values)
  save_twin(folder / "twin.toml", twin, theta, "a twin")
  return ["twin.toml"]


def _read_twin(folder: Path) -> object:
  twin, theta = load_twin(folder / "twin.toml", threads=1)
  return [theta, twin.model.body_mass]


def _vehicle(folder: Path) -> list[str]:
  lines = ['name = "car"', 'layout = "rear"', 'drive = "current"']
  for name in ("mass", "yaw_inertia", "wheel_radius", "cg_to_front", "motor_damping"):
    value = getattr(QCAR, name)
    lines.append(f'[{name}]\nvalue = {value!r}\nunit = "SI"\nsource = "scale"\nstd = {0.1 * value!r}')
  (folder / "car.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
  return ["car.toml"]


def _read_vehicle(folder: Path) -> object:
  car = Vehicle.load(folder / "car.toml")
  return [car.mass, car.chassis_yaw_inertia, car.torque_per_ampere]


def _policy(folder: Path) -> None:
  random = np.random.default_rng(0)
  shapes = ((16, 4), (16, 16), (1, 16))
  layers = tuple((random.normal(size=s).astype(np.float32), np.zeros(s[0], np.float32)) for s in shapes)
  save_policy(Policy(layers, (1.0, 2.0, 3.0, 4.0), provenance={"training": {"seed": 0}}), folder)


def _policy_json(folder: Path) -> list[str]:
  _policy(folder)
  return ["policy.json"]


def _policy_weights(folder: Path) -> list[str]:
  _policy(folder)
  return ["policy.safetensors"]


def _read_policy(folder: Path) -> object:
  return load_policy(folder).rate(np.zeros((2, 4)))


def _controllers(folder: Path) -> list[str]:
  controllers.save(controllers.entries(), folder / "controllers.toml")
  return ["controllers.toml"]


def _read_controllers(folder: Path) -> object:
  car = Model.nominal().car
  return len(controllers.load(car, 0.5, folder / "controllers.toml"))


def _identification(folder: Path) -> list[str]:
  identify(DataSet.load(ROOT / "data" / "sample")).save(folder / "identification.json")
  return ["identification.json"]


def _read_identification(folder: Path) -> object:
  return Identification.load(folder / "identification.json").theta


def _archive(folder: Path) -> list[str]:
  answers = folder / "answers"
  answers.mkdir()
  for name in ("null_00", "single_00"):
    answer = {"verdict": "no_mismatch", "claims": []}
    result = {"case": {"name": name, "seed": 1}, "answer": answer, "sha256": digest(answer), "truth": []}
    keep(result, answers / f"{name}.json")
  pack(answers, folder / "answers.jsonl.xz")
  return ["answers.jsonl.xz"]


def _read_archive(folder: Path) -> object:
  return unpack(folder / "answers.jsonl.xz", folder / "unpacked")


def _truth(folder: Path) -> list[str]:
  seal({"effects": [{"id": "payload", "size": 1.0}]}, folder / "data", folder / "truth", packed=True)
  return [f"truth/{path.name}" for path in (folder / "truth").iterdir()]


def _read_truth(folder: Path) -> object:
  return len(unseal(folder / "truth"))


KINDS: dict[str, Kind] = {
  "csv": Kind(_log("run.csv", _csv), _streams, True),
  "parquet": Kind(_log("run.parquet", _parquet), _streams),
  "npz": Kind(_log("run.npz", _npz), _streams),
  "mat": Kind(_log("run.mat", _mat), _streams),
  "mcap": Kind(lambda folder: _bag(folder, StoragePlugin.MCAP, "drive.mcap"), _streams),
  "ros2 sqlite": Kind(lambda folder: _bag(folder, StoragePlugin.SQLITE3, "drive"), _streams),
  "ros1 bag": Kind(_ros1, _streams),
  "dataset.toml": Kind(_manifest, _streams, True),
  "twin.toml": Kind(_twin, _read_twin, True),
  "vehicle.toml": Kind(_vehicle, _read_vehicle, True),
  "policy.json": Kind(_policy_json, _read_policy, True),
  "policy.safetensors": Kind(_policy_weights, _read_policy),
  "controllers.toml": Kind(_controllers, _read_controllers, True),
  "identification.json": Kind(_identification, _read_identification, True),
  "answers.xz": Kind(_archive, _read_archive),
  "truth": Kind(_truth, _read_truth, True),
}
