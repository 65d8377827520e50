"""The plugin is built by whatever compiler there is, never half, never stale, and loads once."""

import os
import shutil
import subprocess
import sys
import threading

import mujoco
import pytest

from qcar_twin.vehicle import tyre
from qcar_twin.vehicle.tyre import build
from qcar_twin.vehicle.tyre.parameters import COLUMN, header, tyre_user_data
from tests.qcar_twin.vehicle.tyre.rig import SHARED, TYRE

_DRIVE = """
import sys, pathlib, mujoco
from qcar_twin.vehicle.tyre import build
build.library_path = lambda: pathlib.Path(sys.argv[1])
from qcar_twin.vehicle.mjcf import car_spec
from qcar_twin.vehicle.vehicle import Vehicle
model = car_spec(Vehicle.load()).compile()
data = mujoco.MjData(model)
data.ctrl[:] = 2.0, 0.25
mujoco.mj_step(model, data, 500)
print(data.qpos.tobytes().hex())
"""


def driven(library: os.PathLike) -> str:
  """State of a car after a second of driving on a given library, in a process of its own."""
  result = subprocess.run([sys.executable, "-c", _DRIVE, str(library)], capture_output=True, text=True, check=True)
  return result.stdout.strip()


def test_every_compiler_here_builds_it_and_the_car_drives_the_same(tmp_path):
  tracks = []
  for k, compiler in enumerate([*build.compilers()[:1], [sys.executable, "-m", "ziglang", "cc"]]):
    library = tmp_path / str(k) / build.library_path().name
    build.compile_plugin(compiler, library)
    assert [path.name for path in library.parent.iterdir()] == [library.name]
    tracks.append(driven(library))
  assert len(tracks[0]) > 100 and tracks[0] == tracks[1]


def test_another_version_of_the_engine_is_refused(monkeypatch):
  monkeypatch.setattr(mujoco, "__version__", "4.0.0")
  with pytest.raises(
    build.BuildError, match=r"written for MuJoCo 3\.17\.x and this is 4\.0\.0; install 'mujoco==3\.17\.\*'"
  ):
    build.build()


def test_the_library_belongs_to_its_source_and_engine(tmp_path, monkeypatch):
  before = build.library_path()
  assert mujoco.__version__ in before.name and before.parent.name == "_build"
  changed = tmp_path / "tyre.c"
  changed.write_bytes(build.SOURCE.read_bytes() + b"\n// changed\n")
  with monkeypatch.context() as patch:
    patch.setattr(build, "SOURCE", changed)
    assert build.library_path().name != before.name
  laws = tmp_path / "laws"
  shutil.copytree(build.FOLDER, laws)
  monkeypatch.setattr(build, "FOLDER", laws)
  assert build.library_path() == before
  header = laws / f"{next(iter(tyre.tyre_laws()))}.h"
  header.write_bytes(header.read_bytes() + b"\n// changed\n")
  assert build.library_path().name != before.name


def test_a_built_library_is_kept():
  first = build.build()
  stamp = first.stat().st_mtime_ns
  assert build.build() == first and first.stat().st_mtime_ns == stamp


def test_loading_again_and_from_threads_does_nothing(monkeypatch):
  tyre.load_plugin()
  calls = []
  monkeypatch.setattr(mujoco, "mj_loadPluginLibrary", calls.append)
  threads = [threading.Thread(target=tyre.load_plugin) for _ in range(4)]
  for thread in threads:
    thread.start()
  for thread in threads:
    thread.join()
  tyre.load_plugin()
  assert calls == []


def test_a_wheels_tag_names_its_law():
  """The C header is written from the same table: what a tag of k calls is the k-th law."""
  text = header()
  for k, (law, own) in enumerate(tyre.tyre_laws().items(), 1):
    values = {name: 1.0 for name in SHARED} | {p.name: p.nominal for p in own}
    assert tyre_user_data(law, **values)[COLUMN["tag"]] == k
    assert (f"case {k}:" if k > 1 else "default:") + f" return {law}_secant(u, rho);" in text
  with pytest.raises(ValueError, match="no tyre law 'round'; there are sine"):
    tyre_user_data("round")


@pytest.mark.parametrize(
  "change, text",
  [
    ({"shape": 1.0}, r"unknown \['shape'\]"),
    ({"cornering_stiffness": 0.0}, "'cornering_stiffness' must be positive"),
    ({"relaxation_length": -0.1}, "'relaxation_length' must be >= 0"),
  ],
)
def test_wrong_tyres_are_refused(change, text):
  good = {name: 1.0 for name in TYRE}
  assert [tyre_user_data(**good)[COLUMN[name]] for name in ("tag", *good)] == [1.0] * (1 + len(good))
  with pytest.raises(ValueError, match=text):
    tyre_user_data(**(good | change))


def test_an_instance_without_wheels_is_refused():
  tyre.load_plugin()
  text = """
  <mujoco><extension><plugin plugin="qcar.tyre"/></extension>
    <worldbody><body><plugin plugin="qcar.tyre"/><freejoint/><geom size="0.1"/></body></worldbody></mujoco>"""
  with pytest.raises(ValueError, match="qcar.tyre: no geom with user data below the body that carries the plugin"):
    mujoco.MjModel.from_xml_string(text)
