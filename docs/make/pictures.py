"""Pictures of the reports for README and guide, taken in a real browser.

`qcar-twin run --dataset data/sample --out out/docs` writes the reports. Then `python -m docs.make.pictures out/docs`
takes docs/pictures/report_*.png and notes in docs/pictures/sections.json which sections the reports had. A test
compares these with the sections that reports have now. Chromium and its driver are needed (`apt-get install chromium
chromium-driver`).
"""

import dataclasses
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from qcar_twin.atomic_io import write_json

FOLDER = Path(__file__).parents[1] / "pictures"
NOTED = "sections.json"
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars")
WIDTH = 1180  # of the window, px


@dataclasses.dataclass(frozen=True)
class Shot:
  """One picture.

  Attributes:
    name: of the file, without suffix.
    report: below the folder of a run.
    section: beginning of the title of the section to show; "" for the top of the page.
    height: of the window, px.
    keys: pressed once the page is drawn.
    part: selector of what is shown of the section; "" for its heading.
  """

  name: str
  report: str
  section: str = ""
  height: int = 860
  keys: str = ""
  part: str = ""


SHOTS = (
  Shot("report_verdict", "diagnosis", height=1180),
  Shot("report_channels", "diagnosis", "Where", 1100, "ne", ".explorer"),
  Shot("report_model", "diagnosis", "The repaired model", 1000),
  Shot("report_calibration", "calibration"),
  Shot("report_cross_validation", "cross_validation"),
)


def titles(report: Path) -> list[str]:
  """Titles of a report's sections, in order."""
  return re.findall(r"<h2>(.*?)</h2>", report.read_text(encoding="utf-8"))


def browser(profile: str) -> Any:
  """Chromium without a window, light.

  Raises:
    FileNotFoundError: it is not installed.
  """
  chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
  if not (chromium and driver):
    raise FileNotFoundError("no browser to take pictures with: apt-get install chromium chromium-driver brings it")
  from selenium import webdriver
  from selenium.webdriver.chrome.service import Service

  options = webdriver.ChromeOptions()
  options.binary_location = chromium
  for flag in (*FLAGS, f"--user-data-dir={profile}"):
    options.add_argument(flag)
  opened = webdriver.Chrome(options=options, service=Service(driver))
  opened.set_script_timeout(120)
  light = {"features": [{"name": "prefers-color-scheme", "value": "light"}]}
  opened.execute_cdp_cmd("Emulation.setEmulatedMedia", light)
  return opened


def take(opened: Any, run: Path, shot: Shot) -> None:
  """One picture of a report in the folder of a run."""
  from selenium.webdriver.common.by import By

  opened.set_window_size(WIDTH, shot.height)
  opened.get((run / shot.report / "report.html").resolve().as_uri())
  opened.execute_async_script("const done = arguments[0]; reportReady.then(done, e => done(String(e)))")
  for key in shot.keys:
    opened.find_element(By.TAG_NAME, "body").send_keys(key)
  opened.execute_async_script(
    "const [title, part, done] = arguments; document.documentElement.style.scrollBehavior = 'auto';"
    "const heading = [...document.querySelectorAll('h2')].find(h => h.textContent.startsWith(title));"
    "const shown = part ? heading.closest('section').querySelector(part) : heading;"
    "if (title) shown.scrollIntoView(); else scrollTo(0, 0); setTimeout(done, 1500)",
    shot.section,
    shot.part,
  )
  opened.save_screenshot(str(FOLDER / f"{shot.name}.png"))


def main(run: Path) -> None:
  """All pictures, and the sections of the reports that they show."""
  FOLDER.mkdir(parents=True, exist_ok=True)
  with tempfile.TemporaryDirectory() as profile:
    opened = browser(profile)
    try:
      for shot in SHOTS:
        take(opened, run, shot)
    finally:
      opened.quit()
  shown = {shot.report: titles(run / shot.report / "report.html") for shot in SHOTS}
  write_json(FOLDER / NOTED, {"reports": shown, "pictures": {shot.name: shot.report for shot in SHOTS}})


if __name__ == "__main__":
  main(Path(sys.argv[1]))
