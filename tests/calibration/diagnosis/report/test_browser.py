"""The page in a real browser: no script errors, the map's click, zoom, film, keys, light and dark, print.

Skipped where Debian's chromium and chromium-driver are not installed.
"""

import base64
import shutil
import time

import numpy as np
import pytest

from calibration.diagnosis.report.demonstration import Demonstration
from calibration.diagnosis.report.page import write_report
from qcar_twin.pages import Clip
from qcar_twin.rendering.film import write_video
from tests.calibration.diagnosis.diagnosis_results import diagnosis_of

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = (
  "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--window-size=1280,1000",
)  # fmt: skip
pytestmark = pytest.mark.skipif(
  not (BROWSER and DRIVER), reason="no browser: apt-get install chromium chromium-driver brings it"
)
# where a spot of the current run lies in the window and on the floor
SPOT = """
const one = reportExplorers[0], map = one.map, layout = map._fullLayout, box = map.getBoundingClientRect();
const trace = map.data[map.data.length - 2], k = Math.floor(trace.customdata.length / 3);
const of = (axis, value) => axis._offset + axis.c2p(value);
return [box.left + of(layout.xaxis, trace.x[k]), box.top + of(layout.yaxis, trace.y[k]), trace.x[k], trace.y[k]];
"""
# the recording and second that was jumped to, and where the car was then
JUMPED = """
const one = reportExplorers[0], route = one.data.runs[one.run].route;
const k = route.t.findIndex(t => Math.abs(t - one.at) < 1e-3);
return [one.at, route.x[k], route.y[k]];
"""


@pytest.fixture(scope="module")
def page(offset_pool, tmp_path_factory):
  folder = tmp_path_factory.mktemp("page")
  random = np.random.default_rng(0)
  frames = (random.integers(0, 255, (90, 160, 3), dtype=np.uint8) for _ in range(60))
  write_video(folder / "film.mp4", frames, 20)
  clip = Clip((folder / "film.mp4").read_bytes(), "driven")
  return write_report(folder, diagnosis_of(offset_pool, ("steering_offset",)), Demonstration(clip))


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
  from selenium import webdriver
  from selenium.webdriver.chrome.service import Service

  options = webdriver.ChromeOptions()
  options.binary_location = BROWSER  # type: ignore[assignment]
  for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
    options.add_argument(flag)
  options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
  driver = webdriver.Chrome(options=options, service=Service(DRIVER))
  driver.set_script_timeout(120)
  yield driver
  driver.quit()


@pytest.fixture
def opened(browser, page):
  """The page, drawn, at its top."""
  browser.get(page.as_uri())
  assert browser.execute_async_script("const done = arguments[0]; reportReady.then(done, e => done(String(e)))") is True
  yield browser
  assert [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def wait(browser, script, seconds=20.0):
  """Until a script's value is true."""
  until = time.monotonic() + seconds
  while not browser.execute_script(script):
    assert time.monotonic() < until, f"never true: {script}"
    time.sleep(0.1)


def press(browser, *keys):
  from selenium.webdriver.common.by import By

  browser.find_element(By.TAG_NAME, "body").send_keys(*keys)


def span(browser):
  return browser.execute_script("return reportExplorers[0].channels._fullLayout.xaxis.range.slice()")


def mouse(browser):
  from selenium.webdriver.common.action_chains import ActionChains

  return ActionChains(browser)


def show(browser, selector):
  browser.execute_script(
    "document.documentElement.style.scrollBehavior = 'auto';"
    "document.querySelector(arguments[0]).scrollIntoView({block: 'start'})",
    selector,
  )


def test_everything_is_drawn_and_nothing_fetched(opened):
  drawn = opened.execute_script("return document.querySelectorAll('.js-plotly-plot .main-svg').length")
  assert drawn >= 2 * 5  # two layers of each of map, channels, shares, evidence, ranking
  fetched = opened.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
  assert [name for name in fetched if not name.startswith("data:")] == []


def test_a_click_on_the_map_moves_the_channels(opened):
  show(opened, ".map")
  x, y, *place = opened.execute_script(SPOT)
  before = span(opened)
  action = mouse(opened)
  action.w3c_actions.pointer_action.move_to_location(int(x), int(y))
  action.w3c_actions.pointer_action.click()
  action.perform()
  wait(opened, "return reportExplorers[0].at !== null && reportExplorers[0].channels.layout.shapes.length > 0")
  wait(opened, f"return reportExplorers[0].channels._fullLayout.xaxis.range[0] !== {before[0]}")
  when, *there = opened.execute_script(JUMPED)
  assert np.hypot(*np.subtract(there, place)) < 0.1
  low, high = span(opened)
  assert low <= when <= high and high - low == pytest.approx(4.0, abs=0.1)


def test_zoom_links_every_channel_and_a_double_click_undoes_it(opened):
  from selenium.webdriver.common.by import By

  show(opened, ".channels")
  area = opened.find_element(By.CSS_SELECTOR, ".channels .nsewdrag")
  whole = span(opened)
  mouse(opened).move_to_element_with_offset(area, -100, 0).click_and_hold().move_by_offset(150, 2).release().perform()
  wait(opened, "return reportExplorers[0].span !== null")
  low, high = span(opened)
  assert whole[0] < low < high < whole[1]
  axes = opened.execute_script("return [...new Set(reportExplorers[0].channels._fullData.map(t => t.xaxis))]")
  panels = opened.execute_script("return reportExplorers[0].channels._fullLayout._subplots.yaxis.length")
  assert axes == ["x"] and panels > 5
  until = time.monotonic() + 60  # two clicks count as one double click only where a busy machine draws them 0.3 s apart
  while opened.execute_script("return reportExplorers[0].span !== null") and time.monotonic() < until:
    mouse(opened).double_click(area).perform()
  wait(opened, "return reportExplorers[0].span === null")


def test_pointing_at_a_channel_marks_the_map(opened):
  from selenium.webdriver.common.by import By

  show(opened, ".channels")
  marked = "const map = reportExplorers[0].map; return map.data[map.data.length - 1].x[0]"
  assert opened.execute_script(marked) is None
  mouse(opened).move_to_element(opened.find_element(By.CSS_SELECTOR, ".channels .nsewdrag")).perform()
  wait(opened, f"{marked} !== null")


def test_the_film_plays(opened):
  show(opened, "video")
  press(opened, "f")
  wait(opened, "return document.querySelector('video').currentTime > 0.3")
  press(opened, "f")
  wait(opened, "return document.querySelector('video').paused")


def test_keys_step_through_moments_errors_and_sections(opened):
  press(opened, "n")
  wait(opened, "return reportExplorers[0].moment === 0 && reportExplorers[0].span !== null")
  press(opened, "n")
  wait(opened, "return reportExplorers[0].moment === 1")
  press(opened, "p")
  wait(opened, "return document.querySelector('.said').textContent.startsWith('moment 1 of')")
  press(opened, "0")
  wait(opened, "return reportExplorers[0].span === null")
  press(opened, "e")
  wait(opened, "return reportExplorers[0].channels._fullLayout.yaxis3.title.text.startsWith('error of')")
  names = opened.execute_script("return reportExplorers[0].channels.data.map(t => t.name)")
  assert "measured" not in names and {"recalibrated twin", "repaired twin"} <= set(names)
  press(opened, "j")
  opened.execute_script("scrollTo({top: 0, behavior: 'instant'})")
  press(opened, "j")
  wait(opened, "return scrollY > 100")


def test_light_and_dark(opened):
  ground = "return getComputedStyle(document.body).backgroundColor"
  line = "return reportExplorers[0].channels.data.find(t => t.name === 'measured').line.color"
  light = opened.execute_script(ground), opened.execute_script(line)
  press(opened, "t")
  wait(opened, f"{line} !== '{light[1]}'".replace("return return", "return"))
  assert opened.execute_script(ground) != light[0]
  press(opened, "t")
  wait(opened, f"{line} === '{light[1]}'")
  assert opened.execute_script(ground) == light[0]


def test_it_prints_with_every_table_open(opened):
  printed = opened.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})
  assert len(base64.b64decode(printed["data"])) > 50_000
  assert opened.execute_script("return document.querySelectorAll('details[open]').length") == 0  # closed again
