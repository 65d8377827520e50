"""Lines that name each of their values."""

import numpy as np
import pytest

from qcar_twin.recordings.first_dataset.place import logs_of
from qcar_twin.recordings.formats import read_table

SERIAL = [f"t:{20 * k} st:{k % 7 - 3} gz:{0.5 * k - 9.0:.1f} v:1e-1" for k in range(60)]
OTHERS = {
  "with commas": ", ".join,
  "as equations": lambda pairs: "; ".join(pair.replace(":", " = ") for pair in pairs),
  "as documents": lambda pairs: "{" + ", ".join('"' + pair.replace(":", '": ') for pair in pairs) + "}",
}


def write(path, lines):
  path.write_text("\n".join(lines) + "\n", encoding="utf-8")
  return path


@pytest.mark.parametrize("style", ["blanks", *OTHERS])
def test_a_serial_monitors_lines_are_rows(tmp_path, style):
  lines = SERIAL if style == "blanks" else [OTHERS[style](line.split()) for line in SERIAL]
  (log,) = logs_of(
    [write(tmp_path / "putty.log", ["=~=~= PuTTY log 2023.11.10 16:20:31 =~=~=", "ready", *lines]).parent]
  )
  table = read_table(log)
  assert set(table.columns) == {"t", "st", "gz", "v"} and table.rows == 60 and not table.notes
  np.testing.assert_allclose(table.columns["gz"], 0.5 * np.arange(60) - 9.0)


def test_torn_lines_are_left_out_with_a_note(tmp_path):
  table = read_table(write(tmp_path / "a.txt", [*SERIAL[:30], "t:600 st:1 g", *SERIAL[31:]]))
  assert table.rows == 59 and table.notes == ("a.txt: 1 of 60 lines have other names than most; left out",)


def test_decoded_messages_keep_their_own_stamps_and_units(tmp_path):
  lines = []
  for k in range(40):
    lines.append(f" (165833.{k:02d}1)  can0  0A1   [8]  EB 11 0F :: Steering(Angle: {k}.5 deg, Valid: 1)")
    lines += [f" (165833.{k:02d}5)  can0  174   [4]  9B 76 :: Imu(YawRate: -{k} deg/s, AccY: 0.01 m/s2)"] * (k % 2)
  table = read_table(write(tmp_path / "dump.txt", lines))
  assert set(table.columns) == {
    "time",
    "Steering.Angle [deg]",
    "Steering.Valid",
    "Imu.YawRate [deg/s]",
    "Imu.AccY [m/s2]",
  }
  sampled = np.isfinite(table.columns["Imu.YawRate [deg/s]"])
  np.testing.assert_allclose(table.columns["time"][sampled], 165833.005 + 0.01 * np.arange(1, 40, 2))
  assert np.isfinite(table.columns["Steering.Angle [deg]"]).sum() == 40


@pytest.mark.parametrize(
  "lines",
  [["mass: 2.7", "wheelbase: 0.26"] * 20, ["time,speed", *(f"{k},{k}" for k in range(40))], SERIAL[:15]],
  ids=["a list", "a table", "few"],
)
def test_other_texts_are_read_as_before(tmp_path, lines):
  path = write(tmp_path / "notes.csv", lines)
  try:
    assert "t" not in read_table(path).columns
  except ValueError as error:
    assert "notes.csv" in str(error)
