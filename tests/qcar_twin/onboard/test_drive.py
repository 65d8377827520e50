"""A script from its first line to its end: the three of this folder, and what is said of those that go wrong."""

import dataclasses
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest

from qcar_twin.onboard.drive import Terms, drive
from qcar_twin.onboard.plants import twin_plant, with_effects
from qcar_twin.onboard.recorder import recording_of
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from tests import ROOT
from tests.qcar_twin.onboard.rig import SCRIPTS, by_hand, drive_text, reduced

RUNS = (("steps.py", ("0", "12")), ("steps.py", ("1", "12")), ("waypoints.py", ("12",)), ("threads.py", ("12",)))


STANDS = """
  import time
  from pal.products.qcar import QCar

  with QCar() as car:
    time.sleep(12)
    car.read()
"""


def columns(name: str, arguments: tuple[str, ...], plant) -> dict[str, np.ndarray]:
  driven = drive(SCRIPTS / name, plant, Terms(arguments))
  assert driven.error == "" and driven.notes == ()
  time, table = recording_of(driven.car, "x").columns()
  return {"time": time, **table}


@pytest.mark.parametrize(("name", "arguments"), RUNS, ids=str)
def test_a_script_gives_the_same_recording_every_time(name, arguments, capsys):
  first, again = (columns(name, arguments, reduced()) for _ in range(2))
  said = capsys.readouterr().out.splitlines()
  assert len(said) == 2 and said[0] == said[1]
  assert all(np.array_equal(first[channel], again[channel], equal_nan=True) for channel in first)
  assert first["time"][-1] == pytest.approx(12.0, abs=0.03) and np.nanmax(first["motor_speed"]) > 150.0


def test_the_script_on_waypoints_keeps_to_them():
  table = columns("waypoints.py", ("12",), reduced())
  x, y = (table[name][np.isfinite(table["pose_x"])] for name in ("pose_x", "pose_y"))
  angle = np.linspace(0.0, 2.0 * np.pi, 2000)
  path = np.stack([1.6 * np.sin(angle), 1.1 * np.sin(angle) * np.cos(angle)])
  apart = np.hypot(x - path[0, :, None], y - path[1, :, None]).min(axis=0)
  assert np.median(apart) < 0.1


def test_both_cars_drive_a_script_alike_and_an_effect_shows():
  twin = Twin(Vehicle.load(), threads=1)
  mujoco = columns("steps.py", ("1", "6"), twin_plant(twin, twin.parameters.nominal))
  fast = columns("steps.py", ("1", "6"), reduced())
  late = twin_plant(*with_effects(twin, twin.parameters.nominal, ("steering_delay=0.1",)), "reduced")
  slow = columns("steps.py", ("1", "6"), late)
  apart = lambda a, b: float(np.sqrt(np.nanmean((a["yaw_rate"] - b["yaw_rate"]) ** 2)))
  assert apart(mujoco, fast) < 0.01 < 0.1 < apart(slow, fast)


def test_twins_share_their_sensors_noise_and_another_car_has_its_own(tmp_path):
  noise = {}
  for whose in ("twin", "mine", "yours"):
    plant = dataclasses.replace(by_hand()[0], sensors=whose)
    driven = drive_text(tmp_path, STANDS, plant)
    noise[whose] = np.array([sample.yaw_rate for sample in driven.car.samples])
  twin = drive_text(tmp_path, STANDS, by_hand()[0])
  assert np.array_equal(noise["twin"], [sample.yaw_rate for sample in twin.car.samples])
  for one, other in (("twin", "mine"), ("mine", "yours")):
    both = np.corrcoef(noise[one], noise[other])[0, 1]
    assert len(noise[one]) > 1000 and abs(both) < 0.1  # three standard deviations of what chance gives


def test_a_sensor_effect_of_the_twin_is_read_on_board():
  twin = Twin(Vehicle.load(), threads=1)
  wrong = twin_plant(*with_effects(twin, twin.parameters.nominal, ("gyro_scale=0.1", "imu_latency=0.05")), "reduced")
  table, true = columns("steps.py", ("1", "6"), wrong), columns("steps.py", ("1", "6"), reduced())
  late = np.corrcoef(table["yaw_rate"][5:], true["yaw_rate"][:-5])[0, 1]
  assert late > np.corrcoef(table["yaw_rate"], true["yaw_rate"])[0, 1]
  steady = slice(240, 250)  # in the first turn
  assert np.mean(table["yaw_rate"][steady]) / np.mean(true["yaw_rate"][steady]) == pytest.approx(1.1, abs=0.03)


@pytest.mark.parametrize(
  ("effect", "said"),
  [
    ("steering_dely=0.1", "no effect 'steering_dely'; did you mean steering_delay"),
    ("steering_delay", "needs a number: steering_delay=0.04, steering_delay in s, from 0 to 0.2"),
    ("steering_delay=9", "out of bounds: give steering_delay in s, from 0 to 0.2"),
  ],
)
def test_an_effect_that_there_is_not_is_said(effect, said):
  twin = Twin(Vehicle.load(), threads=1)
  with pytest.raises(ValueError, match=said.replace("(", "\\(")):
    with_effects(twin, twin.parameters.nominal, (effect,))


def test_an_error_is_shown_as_the_script_alone_would_show_it_and_the_drive_is_kept(tmp_path):
  text = """
    import time
    from pal.products.qcar import QCar

    def loop(car):
      car.write(0.1, 0.0)
      time.sleep(2.0)
      return 1 / 0

    loop(QCar())
  """
  driven = drive_text(tmp_path, text)
  assert driven.error.startswith("Traceback (most recent call last):") and "return 1 / 0" in driven.error
  assert driven.error.endswith("ZeroDivisionError: division by zero") and "runpy" not in driven.error
  assert recording_of(driven.car, "kept").duration == pytest.approx(2.0, abs=0.02)


def test_a_camera_is_refused_in_a_sentence_where_it_is_made(tmp_path):
  text = """
    from pal.products.qcar import QCar, QCarRealSense
    car = QCar()
    camera = QCarRealSense(mode="RGB")
  """
  error = drive_text(tmp_path, text).error
  assert "QCarRealSense: the simulated car has no camera" in error and "script.py" in error
  assert "offer.py" not in error  # our own frames are none of the script's


def test_a_script_that_never_reads_or_never_opens_a_car_is_told_so(tmp_path):
  blind = "import time\nfrom pal.products.qcar import QCar\ncar = QCar()\ncar.write(0.1, 0)\ntime.sleep(1)\n"
  assert "never read the car (1 writes)" in drive_text(tmp_path, blind).notes[0]
  assert drive_text(tmp_path, "import time\ntime.sleep(1)\n").notes == (
    "the script made no QCar, so nothing was driven",
  )


@pytest.mark.parametrize("loop", ["while True: pass", "while True:\n  try: 1 / 0\n  except Exception: pass"])
def test_a_loop_that_never_looks_at_a_clock_is_ended(tmp_path, loop):
  driven = drive_text(tmp_path, f"from pal.products.qcar import QCar\ncar = QCar()\n{loop}\n", patience=0.6)
  assert "ran for 0.6 s without looking at a clock or at the car" in driven.error and driven.wall < 20.0


def test_a_thread_s_error_is_noted_and_the_script_goes_on(tmp_path):
  text = """
    import threading, time
    def fails():
      time.sleep(1.0)
      raise ValueError("lost it")
    threading.Thread(target=fails, name="worker").start()
    time.sleep(2.0)
  """
  driven = drive_text(tmp_path, text)
  assert driven.error == "" and driven.seconds == pytest.approx(2.0, abs=0.01)
  assert driven.notes[1].startswith("thread 'worker' ended early, the script went on without it: Traceback")
  assert "ValueError: lost it" in driven.notes[1]


def test_such_a_loop_in_a_thread_is_ended_too(tmp_path):
  text = """
    import threading
    def forever():
      while True: pass
    thread = threading.Thread(target=forever)
    thread.start()
    thread.join()
  """
  driven = drive_text(tmp_path, text, patience=0.6)
  assert driven.wall < 20.0 and "without looking at a clock" in driven.notes[1]


def test_a_script_without_an_end_is_stopped_as_by_ctrl_c(tmp_path, capsys):
  text = """
    import time
    from pal.products.qcar import QCar
    car = QCar(readMode=1, frequency=100)
    try:
      while True:
        car.read()
        car.write(0.1, 0.0)
    except KeyboardInterrupt:
      car.terminate()
      print("tidied up")
  """
  driven = drive_text(tmp_path, text, seconds=3.0)
  assert driven.error == "" and driven.seconds == pytest.approx(3.0, abs=0.1)
  assert capsys.readouterr().out == "tidied up\n" and "stopped after 3 s" in driven.notes[0]


def test_a_script_with_its_own_answer_to_ctrl_c_gives_it(tmp_path):
  text = """
    import signal, time
    stop = []
    signal.signal(signal.SIGINT, lambda *_: stop.append(1))
    while not stop:
      time.sleep(0.1)
  """
  driven = drive_text(tmp_path, text, seconds=2.0)
  assert driven.error == "" and driven.seconds == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(
  ("text", "said"),
  [
    ("import sys; sys.exit(3)", "the script ended itself with exit code 3"),
    ("import threading; threading.Event().wait()", "every thread of the script waits for another one"),
    ("import multiprocessing as m; m.Process(target=print).start()", "starts another process"),
    ("import subprocess; subprocess.run(['echo', 'hello'])", "starts another process (echo hello)"),
    ("import os; os.system('echo hello')", "starts another process (echo hello)"),
    ("import os; os.popen('echo hello')", "starts another process"),
    ("import os; os.fork()", "starts another process (a copy of itself)"),
    ("def broken(:", "SyntaxError: "),
  ],
)
def test_other_ends_are_said(tmp_path, text, said):
  assert said in drive_text(tmp_path, text).error


def test_an_event_loop_and_dates_live_on_the_simulated_clock(tmp_path, capsys):
  text = """
    import asyncio, threading, time
    async def main():
      for _ in range(200):
        await asyncio.sleep(0.01)
      loop, done = asyncio.get_running_loop(), asyncio.Event()
      threading.Timer(0.5, lambda: loop.call_soon_threadsafe(done.set)).start()
      await asyncio.wait_for(done.wait(), 5.0)
    asyncio.run(main())
    print(time.strftime("%Y"), time.localtime().tm_year, time.gmtime(0).tm_year, time.ctime(0)[-4:])
  """
  began = time.monotonic()
  driven = drive_text(tmp_path, text)
  assert driven.error == "" and driven.seconds == pytest.approx(2.5, abs=0.1)
  assert time.monotonic() - began < 10.0  # 2.5 s of waiting, and not a poll for each microsecond of it
  assert capsys.readouterr().out.split()[:4] == ["2020", "2020", "1970", "1970"]


def test_an_end_by_sys_exit_without_a_code_is_none(tmp_path):
  assert drive_text(tmp_path, "import sys; sys.exit()").error == ""


def test_random_numbers_and_the_script_s_own_modules_are_its_own(tmp_path, capsys):
  for name, number in (("a", 1), ("b", 2)):
    (tmp_path / name).mkdir()
    (tmp_path / name / "settings.py").write_text(f"NUMBER = {number}\n", encoding="utf-8")
  text = "import random, numpy, settings\nprint(settings.NUMBER, random.random(), numpy.random.random())\n"
  state = np.random.get_state()[1].copy()
  for name in ("a", "b", "a"):
    drive_text(tmp_path / name, text)
  first, second, third = capsys.readouterr().out.splitlines()
  assert first == third and first[0] == "1" and second == "2" + first[1:]
  assert np.array_equal(np.random.get_state()[1], state) and "settings" not in sys.modules


def test_a_script_that_asks_hears_the_answers_given_and_then_enter(tmp_path, capsys):
  driven = drive_text(tmp_path, "print([input('again? '), input(), input('and now? ')])\n", answer=("n", "7"))
  assert driven.error == "" and capsys.readouterr().out == "again? n\n7\nand now? \n['n', '7', '']\n"
  assert "the script asked 'and now? ' and heard Enter" in driven.notes[-1]


@pytest.mark.parametrize(
  "waiting",
  ["while worker.is_alive(): pass", "while not done.is_set(): pass", "while worker.is_alive(): scope.refresh()"],
)
def test_a_main_thread_that_only_looks_whether_the_other_is_done_gets_on(tmp_path, waiting):
  text = f"""
    import threading, time
    from pal.utilities.scope import MultiScope
    scope, done = MultiScope(rows=1, cols=1), threading.Event()
    def work():
      time.sleep(3.0)
      done.set()
    worker = threading.Thread(target=work)
    worker.start()
    {waiting}
  """
  driven = drive_text(tmp_path, text)
  assert driven.error == "" and driven.seconds == pytest.approx(3.0, abs=0.01)


def test_a_queue_that_is_polled_lets_the_other_thread_get_on(tmp_path):
  text = """
    import queue, threading, time
    box = queue.Queue()
    threading.Thread(target=lambda: (time.sleep(0.05), box.put(1))).start()
    while True:
      try:
        box.get_nowait()
        break
      except queue.Empty:
        continue
  """
  driven = drive_text(tmp_path, text)
  assert driven.error == "" and driven.seconds == pytest.approx(0.05, abs=0.001)


def test_no_such_script_is_said(tmp_path):
  with pytest.raises(FileNotFoundError, match="no such script; name the Python file that drives the QCar"):
    drive(tmp_path / "none.py", reduced())


def test_importing_the_room_changes_nothing_and_nothing_named_pal_is_installed():
  code = "import sys, time; before = time.time; import qcar_twin.onboard.drive; import qcar_twin.onboard.offer\n"
  code += (
    "assert time.time is before and 'pal' not in sys.modules and not any('offer' in str(f) for f in sys.meta_path)"
  )
  subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
  assert shutil.which("pal") is None
  with pytest.raises(ModuleNotFoundError):
    __import__("pal")
