"""A file of several runs is as many drives to whoever reads it: `new`, `look` and `scan`."""

import numpy as np
import pytest

from calibration.fleet.logs import find_logs
from calibration.fleet.scan import line_of
from qcar_twin.recordings.dataset import DataSet
from scripts import look, new
from tests import ROOT
from tests.qcar_twin.recordings.drives import drive, write_csv


@pytest.fixture
def log(tmp_path):
  (time, first), (_, second) = drive(seed=1), drive(seed=2)
  (tmp_path / "logs").mkdir()
  twice = {name: np.r_[values, second[name]] for name, values in first.items()}
  return write_csv(tmp_path / "logs" / "day.csv", np.r_[time, time], twice)


def test_each_command_reads_both(log, tmp_path, capsys):
  look.main(look.Config((log,), tmp_path / "page"))
  assert "day.csv: its clock begins again in row 1201; read as 2 runs" in capsys.readouterr().out
  new.main(new.Config(tmp_path / "set", (log,)))
  runs = {recording.name: recording.duration for recording in DataSet.load(tmp_path / "set").recordings}
  assert runs == pytest.approx({"day_1": 11.99, "day_2": 11.99})
  for like in (None, ROOT / "data" / "sample"):
    line = line_of(find_logs(log.parent)[0], "check", like)
    assert line["state"] != "refused" and line["driven"] == pytest.approx(23.98)
  assert [path.name for path in log.parent.iterdir()] == ["day.csv"]
