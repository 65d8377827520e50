"""Pictures of the reports for README and guide, taken in a real browser.

`qcar-twin run --dataset data/sample --out out/docs` writes the reports, and the pages of a log come from

  qcar-twin check --dataset data/sample --out out/docs/check
  qcar-twin look data/sample/excitation_[ab].csv data/sample/free_drive_a.csv --out out/docs/look

Then `python -m docs.make.pictures out/docs` takes docs/pictures/report_*.png and notes in docs/pictures/sections.json
which sections the reports had; with names of reports behind it, only their pictures. A test compares the sections with
those that reports have now. Chromium and its driver are needed (`apt-get install chromium chromium-driver`).
"""

import dataclasses
import json
import re
import shutil
import sys
import tempfile
from collections.abc import Sequence
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
    report: below the folder of a run, which holds report.html or check.html.
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
  Shot("report_check", "check", height=1000),
  Shot("report_look", "look", "The log", 1100),
)


def page_of(run: Path, report: str) -> Path:
  """The page of a report in the folder of a run."""
  return next(path for name in ("report.html", "check.html") if (path := run / report / name).is_file())


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
  opened.get(page_of(run, shot.report).resolve().as_uri())
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


def main(run: Path, reports: Sequence[str] = ()) -> None:
  """All pictures, or those of some reports, and the sections of the reports that they show."""
  FOLDER.mkdir(parents=True, exist_ok=True)
  shots = [shot for shot in SHOTS if not reports or shot.report in reports]
  with tempfile.TemporaryDirectory() as profile:
    opened = browser(profile)
    try:
      for shot in shots:
        take(opened, run, shot)
    finally:
      opened.quit()
  before = json.loads((FOLDER / NOTED).read_text(encoding="utf-8")) if reports else {"reports": {}, "pictures": {}}
  shown = {shot.report: titles(page_of(run, shot.report)) for shot in shots}
  pictures = {shot.name: shot.report for shot in shots}
  write_json(FOLDER / NOTED, {"reports": before["reports"] | shown, "pictures": before["pictures"] | pictures})


if __name__ == "__main__":
  main(Path(sys.argv[1]), sys.argv[2:])
