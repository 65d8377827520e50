"""Negative numbers that lost their sign get it back; clocks, counters and large numbers stay what they are."""

import numpy as np
import pytest

from qcar_twin.recordings.formats import read_table
from qcar_twin.recordings.formats.table import Table
from qcar_twin.recordings.formats.unsigned import signed
from qcar_twin.recordings.mapping import Mapped, streams_of


def _read(values):
  return signed(Table("log.csv", {"erpm": np.asarray(values, float)}, {})).columns["erpm"]


@pytest.mark.parametrize("bits", [16, 32])
def test_a_reverse_drive_of_an_unsigned_column_is_one_backwards(bits):
  true = np.round(3000.0 * np.sin(np.linspace(0.0, 12.0, 400)))
  assert np.array_equal(_read(np.where(true < 0.0, true + 2.0**bits, true)), true)


@pytest.mark.parametrize(
  "values",
  [
    np.arange(400.0) * 150.0,  # a counter through all of 16 bit
    4.2e9 + np.arange(400.0) * 10.0,  # microseconds of a long day
    60_000.0 + np.arange(400.0),  # a counter that stays high
    np.r_[np.zeros(399), 65535.0],  # one sample: a code for "none"
    np.r_[0.5, np.full(5, 4294966296.0), np.zeros(5)],  # no whole numbers
    np.r_[-1.0, np.full(5, 4294966296.0), np.zeros(5)],  # has a sign
  ],
)
def test_what_may_be_as_it_is_written_stays(values):
  assert np.array_equal(_read(values), values)


def test_the_note_names_the_column_and_the_channel(tmp_path):
  time = np.arange(200) * 0.01
  erpm = np.round(4000.0 * np.sin(3.0 * time))
  rows = [f"{t:.2f},1.5,{int(e) % 2**32}" for t, e in zip(time, erpm, strict=True)]
  (tmp_path / "log.csv").write_text("\n".join(["time,volts,erpm", *rows]))
  mapping = {"time": Mapped("time"), "motor_voltage": Mapped("volts"), "motor_speed": Mapped("erpm", scale=0.05)}
  streams, notes = streams_of(read_table(tmp_path / "log.csv"), mapping)
  assert np.allclose(streams["motor_speed"].value, 0.05 * erpm)
  assert notes == [
    "log.csv: column 'erpm' for motor_speed has negative numbers of 32 bit without their sign; they are read with it"
  ]
