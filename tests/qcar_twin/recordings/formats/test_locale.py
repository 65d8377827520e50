"""Names of files where a locale knows ASCII only."""

import os
import subprocess
import sys

import pyarrow
import pyarrow.parquet

from tests import ROOT
from tests.qcar_twin.recordings.drives import drive, write_csv

TIME, COLUMNS = drive(3.0)


def test_a_folder_and_a_file_beyond_ascii_are_read_in_a_posix_locale(tmp_path):
  """Where every name is bytes; pyarrow and the data set's own text take names for UTF-8."""
  folder = tmp_path / "Prüfstand"
  folder.mkdir()
  write_csv(folder / "größe.csv", TIME, COLUMNS)
  pyarrow.parquet.write_table(pyarrow.table({"time": TIME, **COLUMNS}), folder / "größe.parquet")
  code = """
import sys
from pathlib import Path
from qcar_twin.recordings.formats import read_inside, read_table
folder = next(path for path in Path(sys.argv[1]).iterdir() if path.is_dir())
files, name = sorted(folder.iterdir()), "gr\\u00f6\\u00dfe.csv"
print([read_table(path).rows for path in files], [read_inside(folder, name).rows])
"""
  posix = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
  command = [sys.executable, "-c", code, tmp_path]
  done = subprocess.run(command, env=posix, capture_output=True, text=True, check=False, cwd=ROOT)
  assert done.stdout == f"[{len(TIME)}, {len(TIME)}] [{len(TIME)}]\n", done.stderr
