"""The script in the guide prints what the guide says."""

import re

from tests import ROOT
from tests.qcar_twin.onboard.rig import drive_text

GUIDE = (ROOT / "docs" / "guide" / "onboard.md").read_text(encoding="utf-8")


def test_the_guide_s_script_prints_what_the_guide_says(tmp_path, capsys):
  (script,) = re.findall(r"^```python\n(.*?)^```", GUIDE, re.M | re.S)
  said = re.search(r"it prints\n\n```\n(.*?)^```", GUIDE, re.M | re.S)
  assert said and drive_text(tmp_path, script).error == ""
  assert capsys.readouterr().out == said[1]
