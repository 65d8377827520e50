"""What a person is told of a data set, each thing once."""

from qcar_twin.recordings.dataset import DataSet
from qcar_twin.recordings.notices import gathered


def test_warnings_alike_are_said_once():
  warnings = ["a.csv: speed is frozen at 0 from 1.2 s", "b.csv: speed is frozen at 0 from 3e-4 s", "c.csv: no"]
  assert gathered(warnings) == ("a.csv: speed is frozen at 0 from 1.2 s (and 1 more like it)", "c.csv: no")
  assert gathered(()) == ()


def test_a_data_set_keeps_its_warnings_and_tells_each_thing_once():
  told = DataSet("lab", (), warnings=("a.csv: held for 0.1 s", "b.csv: held for 0.2 s"))
  assert len(told.warnings) == 2 and told.notices == ("a.csv: held for 0.1 s (and 1 more like it)",)
