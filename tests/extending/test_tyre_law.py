"""A tyre law is three files: the example of the page is built, holds what laws must, leaves others as they were."""

import pytest

from tests.extending.example import Copy, files_of

FILES = files_of("A tyre law")
PAGE = "docs/reference/tyre.md"

_DRIVEN = """
import dataclasses, sys, mujoco
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import QCAR
model = car_spec(dataclasses.replace(QCAR, tyre_law=sys.argv[1])).compile()
data = mujoco.MjData(model)
data.ctrl[:] = 3.0, 0.4
mujoco.mj_step(model, data, 600)
print(data.qpos.tobytes().hex(), data.qvel.tobytes().hex())
"""
_FITTED = """
import dataclasses, numpy as np
from qcar_twin.plant import START, Segments
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
twin = Twin(Vehicle.from_dataset({"tyre_law": "brush"}), threads=1)
assert "sliding_share" in twin.base and "tyre_shape" not in twin.base
start = np.zeros((1, len(START)))
start[0, START.index("velocity_x")] = 2.5
drive = Segments(np.tile([2.0, 0.5], (1, 60, 1)), start, np.full(1, 60), 0.01, ("a",), np.zeros(1))
theta = np.stack([twin.parameters.vector({"sliding_share": s}) for s in (0.6, 1.0)])
yaw_rate = twin.rollout(theta, drive).channel("yaw_rate")[:, 0, -1]
assert yaw_rate[0] < 0.97 * yaw_rate[1], yaw_rate
print("fitted")
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
  return Copy(tmp_path_factory.mktemp("project"))


def test_three_files_are_all_it_takes(copy):
  before = copy.python("-c", _DRIVEN, "sine")
  for path, text in FILES.items():
    target = copy.folder / path
    if path == PAGE:
      text = target.read_text(encoding="utf-8").replace("\n## In the solver\n", f"\n{text}\n## In the solver\n")
    target.write_text(text, encoding="utf-8")
  assert copy.touched() == set(FILES) and len(FILES) == 3
  assert copy.python("-c", _DRIVEN, "sine") == before  # another law changes no bit of this one
  assert copy.python("-c", _DRIVEN, "brush") != before
  assert copy.python("-c", _FITTED).strip() == "fitted"
  laws = "tests/qcar_twin/vehicle/tyre/test_law.py"
  assert copy.tests(laws, "tests/qcar_twin/vehicle/tyre/test_build.py", "-k", "brush or tag_names") >= 5
  assert copy.touched() == set(FILES)
