"""A twin beside logs of its own making: silent while it holds, the change named, with its size, when it does not."""

import csv
import dataclasses
import json

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from calibration.watch.effects import CHANGES, Change, known_to, ordinary, watching
from calibration.watch.evidence import BLOCK
from calibration.watch.follow import CsvTail, McapTail, as_recordings, pieces, tail_of
from calibration.watch.watch import Alarm, Watch, clock
from qcar_twin.plant import START
from qcar_twin.recordings.dataset_writer import write_dataset
from qcar_twin.recordings.manifest import Mapped, read_manifest
from qcar_twin.recordings.recording import Recording, RecordingError, Stream
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from scripts import watch as watch_command

NOISE = {"motor_speed": 0.5, "accel_x": 0.05, "accel_y": 0.05, "yaw_rate": 0.006}


@pytest.fixture(scope="module")
def car():
  """Twin on the reduced car with what a watch needs, and its parameters."""
  twin = Twin(Vehicle(), threads=1)
  return watching(twin, twin.parameters.nominal)


def driven(twin, theta, seconds, seed, name="drive"):
  """A recording of the twin itself with sensor noise, weaving at changing speed."""
  random, time = np.random.default_rng(seed), np.arange(0.0, seconds, 0.01)
  voltage = 2.2 + 0.8 * np.sin(0.7 * time + random.uniform(0, 6)) + 0.4 * np.sign(np.sin(0.31 * time))
  steering = 0.3 * np.sin(1.3 * time + random.uniform(0, 6)) + 0.15 * np.sign(np.sin(2.1 * time))
  simulation = twin.begin(theta[None], np.zeros((1, len(START))))
  shown = []
  for command_now in np.column_stack([voltage, steering]):
    shown.append(simulation.signals[0].copy())
    simulation.step(command_now[None])
  shown = np.array(shown)
  columns = {"motor_voltage": voltage, "steering_command": steering}
  for channel, std in NOISE.items():
    place = {"motor_speed": 8, "accel_x": 6, "accel_y": 7, "yaw_rate": 5}[channel]
    columns[channel] = shown[:, place] + std * random.standard_normal(len(time))
  return Recording.from_columns(name, time, columns)


@pytest.fixture(scope="module")
def reference(car):
  return [driven(*car, 24.0, seed, f"reference_{seed}") for seed in range(5)]


@pytest.fixture
def watch(car, reference):
  twin, theta = car
  return Watch(twin, theta, reference)


def test_the_twin_beside_itself_is_silent(car, watch):
  for seed in range(20, 30):
    told, observations, predicted = watch.take(driven(*car, 30.0, seed))
    assert told == []
  errors = (observations.measured - predicted)[observations.select("yaw_rate")]
  assert (
    NOISE["yaw_rate"] < float(np.std(errors)) < 2.0 * NOISE["yaw_rate"]
  )  # each window starts from what was measured


def test_another_day_is_no_change(car, watch):
  """A gyro with another zero, and a battery that gives a tenth less: the twin still holds."""
  twin, theta = car
  for seed, one in enumerate(ordinary(twin)):
    for sign in (1.0, -1.0):
      told, _, _ = watch.take(driven(twin, one.at(watch.twin, theta, sign * one.size), 30.0, 60 + seed))
      assert told == [], one.name


def test_a_drive_by_current_has_no_battery_that_sags():
  twin = Twin(Vehicle(drive="current"), threads=1)
  beside, theta = watching(twin, twin.parameters.nominal)
  names = [c.name for c in known_to(beside, CHANGES)]
  assert "sag" not in names and "grip" in names and len(theta) == len(beside.parameters.names)
  assert {c.name for c in ordinary(beside)} == {"gyro_bias", "accel_bias_x", "accel_bias_y"}
  assert known_to(beside, [Change("none", "none", 1.0, shifts=("of_no_twin",))]) == ()


@pytest.mark.parametrize(
  "change", [c for c in CHANGES if c.name in ("grip", "sag", "steering_delay")], ids=lambda c: c.name
)
def test_a_change_is_named_with_its_size_within_twenty_seconds(car, watch, change):
  twin, theta = car
  watch.take(driven(twin, theta, 30.0, 50))
  told, _, _ = watch.take(driven(twin, change.at(watch.twin, theta, change.size), 40.0, 51))
  assert told and told[0].time <= 20.0 and told[0].change.name == change.name
  assert told[0].size == pytest.approx(change.size, rel=0.35)
  assert change.words in told[0].sentence and "no longer holds" in told[0].sentence


def test_a_time_of_day_is_said_where_the_log_has_one():
  assert clock(1.7e9 + 61.0).endswith("UTC") and clock(75.5) == "1:15.5 min" and clock(59.97) == "1:00.0 min"
  alarm = Alarm(1.7e9 + 20.0, 1.7e9, CHANGES[1], -0.18, 20.0)
  assert "rear cornering stiffness -18 %" in alarm.sentence


def write_log(path, recording, rows=None):
  names = list(recording.streams)
  time = recording[names[0]].time
  with path.open("w", newline="", encoding="utf-8") as file:
    table = csv.writer(file)
    table.writerow(["time", *names])
    for k in range(len(time) if rows is None else rows):
      table.writerow([f"{time[k]:.4f}", *(repr(float(recording[n].value[k])) for n in names)])


@pytest.fixture
def desk(tmp_path, car, reference):
  twin, theta = car
  save_twin(tmp_path / "twin.toml", twin, theta)
  kept = [dataclasses.replace(r, file=f"{r.name}.csv", before=None) for r in reference]
  vehicle = {k: v for k, v in dataclasses.asdict(Vehicle()).items() if k in ("mass", "yaw_inertia", "wheel_radius")}
  vehicle |= {"cg_to_front": 0.128, "cg_to_rear": 0.128, "gear_ratio": Vehicle().gear_ratio, "max_steering": 0.5236}
  write_dataset(tmp_path / "data", "tiny", vehicle, {}, tuple(kept))
  return tmp_path


def test_rows_come_as_they_are_written(desk, car):
  log, whole = driven(*car, 13.0, 70), desk / "whole.csv"
  write_log(whole, log)
  manifest, live = read_manifest(desk / "data"), desk / "live.csv"
  content = whole.read_bytes()
  tail, spans = None, []
  for end in range(0, len(content) + 3001, 3001):  # never at the end of a row
    live.write_bytes(content[:end])
    tail = tail or CsvTail(live)
    spans += [(since, piece) for piece, since in pieces(tail, manifest, "live", BLOCK)]
  assert [round(since, 6) for since, _ in spans] == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
  since, piece = spans[3]
  same = log["yaw_rate"]
  rows = (same.time >= since - BLOCK - 1e-9) & (same.time < since + BLOCK - 1e-9)
  np.testing.assert_allclose(piece["yaw_rate"].value, same.value[rows])
  assert len(tail._rows) < 700  # what was judged is forgotten


def test_an_mcap_file_without_its_end_is_read_as_far_as_it_goes(desk, car):
  log, path = driven(*car, 5.0, 71), desk / "live.mcap"
  with path.open("wb") as file:
    writer = Writer(file, chunk_size=4096)
    writer.start()
    schema = writer.register_schema("row", "jsonschema", b"{}")
    channel = writer.register_channel("/car", "json", schema)
    for k, time in enumerate(log["yaw_rate"].time):
      row = {name: float(log[name].value[k]) for name in log.streams}
      writer.add_message(channel, int(1e9 * time), json.dumps(row).encode(), int(1e9 * time))
    file.flush()
    torn = path.read_bytes()[:-100]
    writer.finish()
  path.write_bytes(torn)
  tail = McapTail(path)
  assert tail.grown()
  named = {name: Mapped(f"/car.{name}") for name in log.streams} | {"time": Mapped("time")}
  manifest = dataclasses.replace(read_manifest(desk / "data"), mapping=named)
  ((recording, _),) = as_recordings(tail.written(desk), manifest, "live")
  count = len(recording["yaw_rate"])
  assert count > 300
  np.testing.assert_allclose(recording["yaw_rate"].value, log["yaw_rate"].value[:count])


def test_a_log_of_another_kind_is_refused(tmp_path):
  with pytest.raises(RecordingError, match="start the log first"):
    tail_of(tmp_path / "none.csv")
  (tmp_path / "log.parquet").write_bytes(b"")
  with pytest.raises(RecordingError, match=".csv and .mcap"):
    tail_of(tmp_path / "log.parquet")


def test_the_command_writes_what_was_measured_and_predicted_and_the_alarm(desk, car, capsys):
  twin, theta = car
  sag = next(c for c in CHANGES if c.name == "sag")
  before, after = driven(twin, theta, 20.0, 80), driven(twin, sag.at(twin, theta, 0.3), 30.0, 81)
  time = np.append(before["yaw_rate"].time, after["yaw_rate"].time + 20.0)
  both = {n: np.append(before[n].value, after[n].value) for n in before.streams}
  write_log(desk / "log.csv", Recording.from_columns("log", time, both))
  config = watch_command.Config(desk / "log.csv", desk / "twin.toml", desk / "data", desk / "out", patience=0.0)
  (alarm, *_) = watch_command.main(config)
  assert 18.0 <= alarm.since <= 26.0 and alarm.change.name == "sag" and alarm.sentence in capsys.readouterr().out
  lines = [json.loads(line) for line in (desk / "out" / "watch.ndjson").read_text().splitlines()]
  yaw = lines[0]["channels"]["yaw_rate"]
  assert np.allclose(np.subtract(yaw["measured"], yaw["predicted"]), yaw["difference"])
  assert len(lines) == 24 and (desk / "out" / "watch.mcap").is_file()


def test_a_torn_row_and_a_clock_that_begins_anew_cost_only_themselves(desk, car, capsys):
  write_log(desk / "log.csv", driven(*car, 20.0, 80))
  rows = (desk / "log.csv").read_text().splitlines(keepends=True)
  again = [rows[0], *rows[1:900], "garbage\n", *rows[900:1100], *rows[1:1000]]
  (desk / "log.csv").write_text("".join(again))
  config = watch_command.Config(desk / "log.csv", desk / "twin.toml", desk / "data", desk / "out", patience=0.0)
  assert watch_command.main(config) == []
  assert "1 rows have other cells than the names above them" in capsys.readouterr().out
  lines = [json.loads(line) for line in (desk / "out" / "watch.ndjson").read_text().splitlines()]
  assert [line["from"] for line in lines] == [*np.arange(0.0, 9.0, 2.0), *np.arange(0.0, 8.0, 2.0)]
  for name, last in (("watch", 9.99), ("watch_2", 7.99)):  # two drives, a file each
    time = [message.log_time for *_, message in stored(desk / "out" / f"{name}.mcap", "/measured/yaw_rate")]
    assert len(time) == len(set(time)) == pytest.approx(100 * last, abs=2) and max(time) == pytest.approx(1e9 * last)


def stored(file, topic):
  with file.open("rb") as stream:
    return list(make_reader(stream).iter_messages(topics=[topic]))


def test_an_alarm_after_a_clock_that_began_anew_has_no_time_of_the_clock_before(car, watch):
  twin, theta = car
  sag = next(c for c in CHANGES if c.name == "sag")
  changed = sag.at(watch.twin, theta, 0.3)
  assert not watch.take(driven(twin, changed, 6.0, 81))[0]  # too little to be sure of
  (first, *_), _, _ = watch.take(driven(twin, changed, 20.0, 82))
  assert first.change.name == "sag" and first.since == -np.inf and first.time <= 6.0
  assert first.sentence.startswith("since before the log began anew the twin no longer holds: battery sag")


class Rows:
  """A clock of which each wait lets a log grow by a part of its rows, as long as there are any."""

  def __init__(self, path, rows, each):
    self.now, self._path, self._rows, self._each = 0.0, path, rows, each

  def monotonic(self):
    return self.now

  def sleep(self, seconds):
    self.now += seconds
    with self._path.open("a", encoding="utf-8") as file:
      file.write("".join(self._rows[: self._each]))
    del self._rows[: self._each]


def test_a_watch_waits_for_its_driver_as_long_as_rows_come(desk, car, capsys, monkeypatch):
  """No command for twelve of twenty seconds, of which each takes one; the watch ends two seconds after the last row."""
  log, path = driven(*car, 20.0, 83), desk / "log.csv"
  write_log(path, log)
  head, *rows = path.read_text(encoding="utf-8").splitlines(keepends=True)
  first = [name.startswith(("motor_voltage", "steering_command")) for name in head.strip().split(",")]
  blank = lambda row: ",".join("" if hidden else c for hidden, c in zip(first, row.strip().split(","), strict=True))
  path.write_text(head, encoding="utf-8")
  clock = Rows(path, [*(f"{blank(row)}\n" for row in rows[:1200]), *rows[1200:]], 100)
  monkeypatch.setattr(watch_command, "time", clock)
  config = watch_command.Config(path, desk / "twin.toml", desk / "data", desk / "out", every=1.0, patience=2.0)
  watch_command.main(config)
  lines = [json.loads(line) for line in (desk / "out" / "watch.ndjson").read_text().splitlines()]
  assert [line["from"] for line in lines] == [12.0, 14.0, 16.0] and clock.now == 22.0
  assert capsys.readouterr().out.count("waiting, nothing can be judged yet: log: needed channel 'motor_voltage'") == 1


def test_decimal_commas_and_quotes_are_no_torn_rows(tmp_path):
  file = tmp_path / "log.csv"
  file.write_text('time;speed;note\n0,01;1,5;a\n0,02;1,6\n0,03;1,7;"b;c"\n', encoding="utf-8")
  tail = CsvTail(file)
  assert tail.grown() and tail.torn == 1 and [row[:4] for row in tail._rows] == ["0,01", "0,03"]


def test_what_a_log_lacks_and_what_no_car_can_do_is_said(desk, car, capsys):
  log = driven(*car, 20.0, 81)
  look = lambda **changed: [
    write_log(desk / "log.csv", log.replace(streams={n: s for n, s in (log.streams | changed).items() if s})),
    watch_command.main(
      watch_command.Config(desk / "log.csv", desk / "twin.toml", desk / "data", desk / "out", patience=0.0)
    ),
  ][1]
  look(yaw_rate=None)
  assert "not watched: yaw_rate; the data set has it, and this log has no sample of it" in capsys.readouterr().out
  gyro = log["yaw_rate"]
  look(yaw_rate=Stream(gyro.time, 0.0 * gyro.value))
  assert "yaw_rate stands at 0 from 0:00.0 min on although the car moves" in capsys.readouterr().out
  alarm, *_ = look(yaw_rate=Stream(gyro.time, np.degrees(gyro.value)))
  assert "a sensor, a unit or a sign of this log is another" in alarm.sentence


def test_a_log_that_cannot_be_judged_is_said(desk, car):
  look = lambda log: watch_command.main(
    watch_command.Config(log, desk / "twin.toml", desk / "data", desk / "out", patience=0.0)
  )
  (desk / "other.csv").write_text("t,v\n0,1\n")
  with pytest.raises(RecordingError, match="nothing could be judged; other: needed channel 'time' is missing"):
    look(desk / "other.csv")
  write_log(desk / "short.csv", driven(*car, 1.0, 82))
  with pytest.raises(RecordingError, match="nothing could be judged; it holds less than 2 s of driving"):
    look(desk / "short.csv")
  with pytest.raises(RecordingError, match="is a folder; name the file in it that is being written"):
    look(desk / "data")
