"""`qcar-twin`: the list of commands, what is said about errors, and what about a stopped run."""

import dataclasses
import importlib
import os
import re
import subprocess
import sys

import pytest

from qcar_twin.atomic_io import write_json
from qcar_twin.command_line import FAILED, INTERRUPTED, MISUSED, sentence
from qcar_twin.extras import MissingExtra
from qcar_twin.recordings.recording import RecordingError
from qcar_twin.rendering.film import RenderingUnavailable
from qcar_twin.twin.file import save_twin
from qcar_twin.twin.twin import Twin
from qcar_twin.vehicle.vehicle import Vehicle
from scripts import diagnose, train, unseal
from scripts.__main__ import USE, commands, main
from tests import ROOT

COMMANDS = commands()
TESTS = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("*.py")]


def test_every_file_is_a_command_with_a_line():
  files = {path.stem.replace("_", "-") for path in (ROOT / "scripts").glob("[!_]*.py")}
  assert set(COMMANDS) == files and len(files) >= 20
  assert all(20 < len(line) <= 92 and line.endswith(".") for line in COMMANDS.values())


def test_the_list_comes_without_loading_anything():
  code = "import sys; from scripts.__main__ import main; main(['--help']); print(set(sys.modules) & {'numpy', 'tyro'})"
  said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT).stdout
  assert said.endswith("set()\n") and all(f"  {name} " in said for name in COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_options_that_explain_themselves(name, capsys):
  with pytest.raises(SystemExit) as stopped:
    main([name, "--help"])
  assert stopped.value.code == 0
  said = capsys.readouterr().out
  assert f"usage: qcar-twin {name}" in said and " ".join(COMMANDS[name].split()[:4]) in said
  module = importlib.import_module(f"scripts.{name.replace('-', '_')}")
  assert f"qcar-twin {name}" in module.__doc__, "a line that can be copied"
  for field in dataclasses.fields(module.Config):  # options, and what is given by its place alone
    assert f"--{field.name.replace('_', '-')}" in said or field.name.upper() in said


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_run_by_a_test(name):
  """Through its `main`, the table of tests/scripts/test_calibration.py, or a process of its own."""
  stem = name.replace("-", "_")
  ways = rf'\b{stem}(_command)?\.main\(|\brun\(\s*"{stem}"|command\("{stem}"|"scripts", "{stem}"'
  assert any(re.search(ways, text) for text in TESTS), f"nothing runs qcar-twin {name}"


@pytest.mark.parametrize(
  ("typed", "said"),
  [
    ("track --out OUT --speed nan", "--speed nan: give a finite number"),
    ("track --out OUT --runs 0", "--runs 0: give more than 0"),
    ("track --out OUT --seed -1", "--seed -1: give 0 or more"),
    ("estimate --dataset data/sample --out OUT --onboard-latency nan", "--onboard-latency nan"),
    ("curves --dataset data/sample --out OUT --most -5", "--most -5.0: give 0 or more"),
    ("export --to mjfc --out OUT", "no export to 'mjfc'; did you mean mjcf?"),
    ("calibrate --dataset data/sample --out OUT --add-mechanisms payload", "give --against recordings"),
    ("look --out OUT", "give LOGS"),
    ("estimate --dataset data/sample --out OUT --onboard-lateness 0.1", "called --onboard-latency now"),
    ("calibrate --dataset data/sample --out OUT --mechanism payload", "--mechanism is called --add-mechanisms now"),
    ("diagnose --dataset data/sample --out OUT --mechanisms payload", "--mechanisms is called --candidates now"),
    ("track --out OUT --plant twin", "--plant twin is called --plant mujoco now"),
    ("render --out OUT --plant=twin", "--plant twin is called --plant mujoco now"),
    ("evaluate --out OUT --plants bicycle twin", "--plants twin is called --plants mujoco now"),
  ],
)
def test_options_that_mean_nothing_are_refused_before_the_work(typed, said, tmp_path, capsys):
  assert main(typed.replace("OUT", str(tmp_path / "out")).split()) == FAILED
  assert said in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_twin_beside_a_car_of_its_own_is_refused(tmp_path, capsys):
  twin = Twin(Vehicle.load())
  file = save_twin(tmp_path / "twin.toml", twin, twin.parameters.nominal)
  assert main(["track", "--out", str(tmp_path / "out"), "--plant", "proving_ground", "--twin", str(file)]) == FAILED
  assert "--twin has no meaning with --plant proving_ground" in capsys.readouterr().err


@pytest.mark.parametrize(("typed", "meant"), [("diagnos", "diagnose"), ("cross_validat", "cross-validate")])
def test_an_unknown_command_is_answered_with_the_nearest(typed, meant, capsys):
  assert main([typed]) == MISUSED
  assert capsys.readouterr().err == f"qcar-twin: no command '{typed}'; did you mean {meant}?\n"
  assert main(["xyzzy"]) == MISUSED and "--help` lists them" in capsys.readouterr().err
  assert main([]) == MISUSED and "usage" in capsys.readouterr().out


def test_the_list_has_what_one_uses_before_what_measures(capsys):
  assert main(["--help"]) == 0
  _, use, measure, _ = re.split(r"\n\n(?=use|measure|`)", capsys.readouterr().out)
  named = [re.findall(r"(?m)^  (\S+) ", part) for part in (use, measure)]
  assert set(USE) & set(COMMANDS) == set(named[0]) and sorted(named[0] + named[1]) == sorted(COMMANDS)
  assert {"benchmark", "campaign", "set-levels", "unseal"} <= set(named[1])


def test_an_alias_runs_the_command_that_it_stands_for(capsys):
  with pytest.raises(SystemExit):
    main(["characterise", "--help"])
  assert "usage: qcar-twin curves" in capsys.readouterr().out


def test_an_unknown_option_is_misuse(capsys):
  with pytest.raises(SystemExit) as stopped:
    main(["unseal", "--daat", "x"])
  assert stopped.value.code == MISUSED and "--daat" in capsys.readouterr().err


def test_what_is_wrong_with_the_input_is_said_in_a_sentence(tmp_path, capsys):
  assert main(["diagnose", "--dataset", str(tmp_path / "none"), "--out", str(tmp_path / "out")]) == FAILED
  said = capsys.readouterr().err.splitlines()
  assert len(said) == 1 and said[0].startswith("qcar-twin diagnose: ") and str(tmp_path / "none") in said[0]
  with pytest.raises(RecordingError):
    main(["--traceback", "diagnose", "--dataset", str(tmp_path / "none"), "--out", str(tmp_path / "out")])


@pytest.mark.parametrize(
  ("error", "said"),
  [
    (FileNotFoundError(2, "No such file or directory", "a/b.csv"), "a/b.csv: No such file or directory"),
    (ValueError("mass must be positive"), "mass must be positive"),
    (KeyError("no path 'q'; did you mean s?"), "no path 'q'; did you mean s?"),
    (RenderingUnavailable("no display"), "no display"),
    (ModuleNotFoundError("No module named 'pandas.io'", name="pandas.io"), "'pandas'"),
    (MissingExtra("Training needs the extra 'learn'"), "Training needs the extra 'learn'"),
    (KeyError("mass"), None),
    (RuntimeError("unforeseen"), None),
    (ModuleNotFoundError("No module named 'qcar_twin.nothing'", name="qcar_twin.nothing"), None),
  ],
)
def test_only_what_is_none_of_the_programs_faults_is_a_sentence(error, said):
  line = sentence(error)
  assert line is None if said is None else said in line


def test_a_verdict_can_be_printed_in_a_posix_locale(tmp_path):
  """Where the terminal's own encoding is ASCII; the folder's name goes out as it came in."""
  folder = tmp_path / "größe"
  code = "import sys; from qcar_twin.command_line import let_every_character_through as f; f(); "
  posix = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
  command = [sys.executable, "-c", f"{code}print('1 m/s\\u00b2 \\u00b7', sys.argv[1])", folder]
  done = subprocess.run(command, env=posix, capture_output=True, check=True, cwd=ROOT)
  assert done.stdout.decode() == f"1 m/s² · {folder}\n"


def test_a_fault_of_the_program_is_shown_in_full(monkeypatch):
  def fail(config):
    raise ZeroDivisionError

  monkeypatch.setattr(unseal, "main", fail)
  with pytest.raises(ZeroDivisionError):
    main(["unseal"])


def test_a_stopped_run_says_what_is_kept(monkeypatch, capsys):
  def stop(config):
    raise KeyboardInterrupt

  for module in (train, unseal):
    monkeypatch.setattr(module, "main", stop)
  assert main(["train", "--out", "x"]) == INTERRUPTED
  assert "--resume goes on from it" in capsys.readouterr().err
  assert main(["unseal"]) == INTERRUPTED and "nothing of this run is kept" in capsys.readouterr().err


def test_a_stopped_run_names_what_it_has_written(monkeypatch, capsys, tmp_path):
  """What lay there before is not its own; a file that was copied with its old time is."""
  (tmp_path / "before.json").write_text("{}")

  def stop(config):
    ranking = write_json(config.out / "staged" / "ranking.json", {})
    os.utime(ranking, (1e9, 1e9))
    raise KeyboardInterrupt

  monkeypatch.setattr(diagnose, "main", stop)
  assert main(["diagnose", "--dataset", "data/sample", "--out", str(tmp_path)]) == INTERRUPTED
  said = capsys.readouterr().err
  assert f"stopped; written so far: {tmp_path / 'staged' / 'ranking.json'}; where staged/recalibrated.toml was" in said
  assert "nothing" not in said and "before.json" not in said


LONG = ("calibrate", "diagnose", "cross-validate", "estimate", "curves", "campaign", "train")


@pytest.mark.parametrize("name", LONG)
def test_a_folder_that_cannot_be_made_is_refused_before_any_work(name, tmp_path, monkeypatch, capsys):
  (tmp_path / "taken").write_text("a file")
  module = importlib.import_module(f"scripts.{name.replace('-', '_')}")
  monkeypatch.setattr(module, "main", lambda config: pytest.fail("work was begun"))
  data = [] if name in ("campaign", "train") else ["--dataset", "data/sample"]
  assert main([name, *data, "--out", str(tmp_path / "taken" / "deep")]) == FAILED
  said = capsys.readouterr().err
  assert f"{tmp_path / 'taken'}" in said and "a file is where a folder has to be; name another folder" in said
  assert (tmp_path / "taken").read_text() == "a file" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("name", COMMANDS)
def test_a_page_that_is_there_already_may_be_written_again(name):
  """A command whose output is a file says so, or the file of its last run would pass for a folder's place taken."""
  module = importlib.import_module(f"scripts.{name.replace('-', '_')}")
  default = getattr(module.Config, "out", None)
  if default is not None and default.suffix:
    assert module.OUT_IS_FILE


def test_an_export_may_be_written_again(tmp_path, monkeypatch, capsys):
  module = importlib.import_module("scripts.export")
  monkeypatch.setattr(module, "main", lambda config: None)
  (tmp_path / "car.xml").write_text("of the last run")
  assert main(["export", "--to", "mjcf", "--out", str(tmp_path / "car.xml")]) == 0
  assert main(["export", "--log", "data/sample/oval.csv", "--out", str(tmp_path / "car.xml")]) == FAILED
  assert "a file is where a folder has to be" in capsys.readouterr().err


@pytest.mark.parametrize(
  ("name", "option", "value", "says"),
  [
    ("calibrate", "--add-mechanisms", "steering_ofset", "no mechanism 'steering_ofset'; did you mean steering_offset"),
    ("diagnose", "--candidates", "sticton", "no mechanism 'sticton'; did you mean stiction"),
    ("diagnose", "--twin", "none.toml", "none.toml: no such twin file; calibrate first"),
    ("cross-validate", "--twin", "pyproject.toml", "pyproject.toml: not a twin file of format"),
    ("train", "--twin", "none.toml", "none.toml: no such twin file; calibrate first"),
  ],
)
def test_a_name_or_a_file_that_is_wrong_is_refused_before_any_work(
  name, option, value, says, tmp_path, monkeypatch, capsys
):
  module = importlib.import_module(f"scripts.{name.replace('-', '_')}")
  monkeypatch.setattr(module, "main", lambda config: pytest.fail("work was begun"))
  data = [] if name == "train" else ["--dataset", "data/sample"]
  assert main([name, *data, "--out", str(tmp_path / "new"), option, value]) == FAILED
  assert says in capsys.readouterr().err and not (tmp_path / "new").exists()


def test_a_simulation_that_flies_apart_prints_nothing_and_leaves_no_file(tmp_path):
  code = (
    "import sys, types, mujoco; from qcar_twin import command_line as c; c._quiet_mujoco();"
    'm = mujoco.MjModel.from_xml_string(\'<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody>'
    "</mujoco>'); d = mujoco.MjData(m); d.qvel[:] = 1e20; mujoco.mj_step(m, d)"
  )
  done = subprocess.run([sys.executable, "-c", code], check=False, cwd=tmp_path, capture_output=True, text=True)
  assert (done.returncode, done.stdout, done.stderr) == (0, "", "") and not list(tmp_path.iterdir())
