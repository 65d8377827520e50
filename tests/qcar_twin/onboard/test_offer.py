"""What a script can import, and what is said of what it cannot."""

import sys
import types

import pytest

from tests.qcar_twin.onboard.rig import drive_text


@pytest.mark.parametrize(
  ("line", "said"),
  [
    ("from pal.products.qcar import QCarGPSS", "no 'QCarGPSS' in pal.products.qcar; did you mean QCarGPS"),
    ("from pal.products.qcar import Xyzzy", "no 'Xyzzy' in pal.products.qcar; there are IS_PHYSICAL_QCAR, QCAR_CONFIG"),
    ("import pal.products.qcarr", "no module 'pal.products.qcarr'; did you mean pal.products.qcar"),
    ("from quanser.hardware import HIL", "no module 'quanser'; there are hal.content.qcar_functions"),
    ("from qvl.qlabs import QuanserInteractiveLabs", "no module 'qvl'"),
    ("from pal import nothing", "no 'nothing' in pal; it holds modules only"),
    ("from hal.products.mats import SDCSRoadMap as M; M()", "SDCSRoadMap: the road map of the manufacturer's mat"),
    ("from pal.utilities.gamepad import LogitechF710 as G; G()", "LogitechF710: nobody is at the controls"),
    ("from pal.utilities.vision import Camera2D as C; C(cameraId='3')", "Camera2D: the simulated car has no camera"),
  ],
)
def test_what_there_is_not_is_said_with_what_there_is(tmp_path, line, said):
  assert said in drive_text(tmp_path, line).error


def test_a_script_that_can_do_without_does(tmp_path, capsys):
  text = """
    try:
      from pal.products.traffic_lights import TrafficLight
    except ImportError as error:
      TrafficLight = None
    from hal.utilities.image_processing import ImageProcessing
    from pal.utilities.math import *
    from pal.utilities.scope import MultiScope
    scope = MultiScope(rows=3, cols=1, title="Speed", fps=30)
    scope.addAxis(row=0, col=0, timeWindow=10, yLabel="m/s", yLim=(0, 1))
    scope.axes[0].attachSignal(name="v", width=2)
    scope.axes[0].sample(0.1, [1.0, 2.0])
    MultiScope.refreshAll()
    print(TrafficLight, round(float(wrap_to_pi(7.0)), 4), round(float(wrap_to_2pi(-1.0)), 4))
  """
  assert drive_text(tmp_path, text).error == ""
  assert capsys.readouterr().out == "None 0.7168 5.2832\n"


def test_what_is_not_offered_comes_from_the_owner_s_own_library(tmp_path, capsys):
  folder = tmp_path / "library" / "hal" / "products"
  folder.mkdir(parents=True)
  (folder / "own.py").write_text("from pal.utilities.math import wrap_to_pi\nNODES = 24\n", encoding="utf-8")
  text = "from hal.products.own import NODES\nfrom pal.products.qcar import QCar\nprint(NODES, QCar.__module__)\n"
  assert drive_text(tmp_path, text, library=tmp_path / "library").error == ""
  assert capsys.readouterr().out.startswith("24 qcar_twin.onboard")


def test_a_library_that_was_imported_before_is_back_afterwards(tmp_path, monkeypatch):
  own = types.ModuleType("pal")
  monkeypatch.setitem(sys.modules, "pal", own)
  assert drive_text(tmp_path, "from pal.products.qcar import QCar\nQCar()\n").error == ""
  assert sys.modules["pal"] is own and "pal.products.qcar" not in sys.modules
