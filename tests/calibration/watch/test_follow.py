"""Logs that hold commands only as they change, and logs that begin anew, followed while they are written."""

import json

import numpy as np
import pytest
from mcap.writer import Writer

from calibration.watch.follow import CsvTail, McapTail, pieces
from qcar_twin.recordings.manifest import Manifest, Mapped

BLOCK = 2.0
TIMES = np.arange(0.0, 20.0, 0.01)
VOLTAGE, STEERING = {0.0: 1.0, 1.0: 2.0, 14.0: 3.0}, {0.0: 0.1, 14.0: 0.2}
NAMES = ("motor_voltage", "steering_command", "speed")


def said(time, changes):
  """What a command was changed to at a time; "" where it was not."""
  return next((value for at, value in changes.items() if abs(at - time) < 1e-6), "")


def rows(times):
  return [f"{t:.2f},{said(t, VOLTAGE)},{said(t, STEERING)},{0.5 + 0.1 * np.sin(t):.6f}" for t in times]


def stood(changes, times):
  return [[value for at, value in changes.items() if at <= t + 1e-6][-1] for t in times]


def manifest(**mapping):
  return Manifest("log", (), {}, {}, mapping)


def checked(spans, last):
  """Blocks up to `last`, s, that follow on each other with the commands that were in force all along."""
  np.testing.assert_allclose([since for _, since in spans], np.arange(0.0, last, BLOCK), atol=1e-9)
  for piece, since in spans:
    begin = max(since - BLOCK, 0.0)
    assert piece["speed"].time[[0, -1]] == pytest.approx([begin, since + BLOCK - 0.01])  # not the next block's first
    time, commands = piece.commands(0.01)
    np.testing.assert_allclose(commands, np.column_stack([stood(VOLTAGE, time), stood(STEERING, time)]))


@pytest.mark.parametrize("most", [10000, 77])
def test_a_command_that_was_logged_as_it_changed_stands_until_it_changes_again(tmp_path, most):
  path, lines, spans = tmp_path / "log.csv", rows(TIMES), []
  path.write_text(",".join(["time", *NAMES]) + "\n")
  tail = CsvTail(path)
  for first in range(0, len(lines), most):
    with path.open("a") as file:
      file.write("\n".join(lines[first : first + most]) + "\n")
    spans += pieces(tail, manifest(), "log", BLOCK)
    assert tail.refused == ""
  checked(spans, 18.0)
  assert len(tail._rows) < 700


def written(file, times):
  """Messages at times, s, into an open file; yields after every second of them, when they are in it."""
  writer = Writer(file, chunk_size=1024)
  writer.start()
  schema = writer.register_schema("row", "jsonschema", b"{}")
  channels = {name: writer.register_channel(f"/{name}", "json", schema) for name in NAMES}
  for k, time in enumerate(times):
    values = (said(time, VOLTAGE), said(time, STEERING), 0.5 + 0.1 * np.sin(time))
    for name, value in zip(NAMES, values, strict=True):
      if value != "":
        message = json.dumps({"value": float(value)}).encode()
        writer.add_message(channels[name], round(1e9 * time), message, round(1e9 * time))
    if k % 100 == 99:
      file.flush()
      yield


MAPPING = {name: Mapped(f"/{name}.value") for name in NAMES} | {"time": Mapped("time")}


def test_a_command_outlives_its_message(tmp_path):
  path, spans = tmp_path / "log.mcap", []
  with path.open("wb") as file:
    tail = McapTail(path)
    for _ in written(file, TIMES):
      spans += pieces(tail, manifest(**MAPPING), "log", BLOCK)
      assert tail.refused == ""
  checked(spans, 18.0)
  assert len(tail._records) < 60


def test_a_log_that_its_logger_begins_anew_is_read_from_its_beginning(tmp_path):
  path, head = tmp_path / "log.csv", ",".join(["time", *NAMES])
  tail = CsvTail(path)
  for times, last in ((TIMES, 18.0), (TIMES[:900], 8.0)):
    path.write_text("\n".join([head, *rows(times)]) + "\n")
    checked(list(pieces(tail, manifest(), "log", BLOCK)), last)
  path.write_text(f"{head},note\n" + "".join(f"{row},a\n" for row in rows(TIMES[:500])))  # with other columns
  checked(list(pieces(tail, manifest(), "log", BLOCK)), 4.0)
  assert tail.torn == 0


def test_a_log_that_is_replaced_by_a_longer_one_is_read_from_its_beginning(tmp_path):
  path, head = tmp_path / "log.csv", ",".join(["time", *NAMES])
  tail = CsvTail(path)
  path.write_text("\n".join([head, *rows(TIMES[:900])]) + "\n")
  checked(list(pieces(tail, manifest(), "log", BLOCK)), 8.0)
  path.write_text(f"note,{head}\n" + "".join(f"a,{row}\n" for row in rows(TIMES)))
  checked(list(pieces(tail, manifest(), "log", BLOCK)), 18.0)
  assert tail.torn == 0


def test_an_mcap_log_that_is_replaced_is_read_from_its_beginning(tmp_path):
  path = tmp_path / "log.mcap"
  path.write_bytes(b"")
  tail = McapTail(path)
  for count, last in ((2000, 18.0), (900, 8.0)):
    with path.open("wb") as file:
      list(written(file, TIMES[:count]))
    checked(list(pieces(tail, manifest(**MAPPING), "log", BLOCK)), last)


def test_a_block_without_a_measurement_is_none(tmp_path):
  path = tmp_path / "log.csv"
  path.write_text("\n".join([",".join(["time", *NAMES]), *rows(TIMES[(TIMES < 4.0) | (TIMES > 10.995)])]) + "\n")
  since = [new for _, new in pieces(CsvTail(path), manifest(), "log", BLOCK)]
  assert since == pytest.approx([0.0, 2.0, 4.0, 10.0, 12.0, 14.0, 16.0])


def test_where_the_clock_begins_anew_after_few_commands_nothing_is_skipped(tmp_path):
  path, lines = tmp_path / "log.csv", rows(TIMES)
  path.write_text("\n".join([",".join(["time", *NAMES]), *lines, *lines[:500]]) + "\n")
  tail = CsvTail(path)
  assert [new for _, new in pieces(tail, manifest(), "log", BLOCK)][-2:] == pytest.approx([0.0, 2.0])
  with path.open("a") as file:
    file.write("\n".join(lines[500:1300]) + "\n")
  spans = list(pieces(tail, manifest(), "log", BLOCK))
  assert [new for _, new in spans] == pytest.approx([4.0, 6.0, 8.0, 10.0])
  assert spans[0][0]["speed"].time[0] == pytest.approx(2.0)


GERMAN = {"speed": "Längsgeschwindigkeit [m/s]", "motor_voltage": "Spannung [V]", "steering_command": "Lenkwinkel [°]"}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le"])
@pytest.mark.parametrize("most", [10**6, 997])
def test_names_in_any_encoding_are_read_however_a_log_grows(tmp_path, encoding, most):
  """`most`: bytes at a time, so that letters are torn."""
  path, spans = tmp_path / "log.csv", []
  named = [",".join(["time", *(GERMAN[name] for name in NAMES), "Straße"]), *(f"{row},größer" for row in rows(TIMES))]
  data = ("\r\n".join(named) + "\r\n").encode(encoding)
  path.write_bytes(b"")
  tail, mapping = CsvTail(path), {name: Mapped(column) for name, column in GERMAN.items()}
  for first in range(0, len(data), most):
    with path.open("ab") as file:
      file.write(data[first : first + most])
    spans += pieces(tail, manifest(**mapping, time=Mapped("time")), "log", BLOCK)
    assert tail.refused == "" and tail.torn == 0
  checked(spans, 18.0)
