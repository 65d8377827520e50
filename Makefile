# Two targets do everything on a fresh machine with Python 3.11: `make run` and `make test`.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/sample
# wheels only; warnings about the machine's package indexes are left out, errors are not; bytecode is made on first use
PIP := $(BIN)/python -m pip install -qq --no-compile --disable-pip-version-check
# where a machine forbids bytecode, every command and every process of a test would compile SciPy and Torch anew
export PYTHONDONTWRITEBYTECODE :=

.PHONY: run test acceptance check docs train install plugin clean

run: install
	$(BIN)/qcar-twin run --dataset data/sample --out $(OUT)

PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test: install
	$(PYTEST) -m "not slow"

# whole fits, searches, trainings and drives, of more than ten seconds each
acceptance: install
	$(PYTEST) -m slow

check: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

# pages from declarations and docstrings, then pictures of the sample's reports; these need chromium and its driver
docs: install
	$(BIN)/python -m qcar_twin.twin.mechanisms.document docs/reference/mechanisms.md
	$(BIN)/python -m docs.make.api
	$(BIN)/python -m docs.make.parameters > docs/reference/parameters.md
	$(BIN)/qcar-twin run --dataset data/sample --out out/docs
	$(BIN)/qcar-twin check --dataset data/sample --out out/docs/check
	$(BIN)/qcar-twin look data/sample/excitation_[ab].csv data/sample/free_drive_a.csv --out out/docs/look
	$(BIN)/python -m docs.make.pictures out/docs

train: install
	$(BIN)/qcar-twin train --out out/train

install: $(VENV)/installed

# The project itself is installed editable: a checkout runs and tests its own sources, changed or not.
$(VENV)/installed: requirements.lock pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) --only-binary :all: -r requirements.lock
	$(PIP) --no-deps --no-index --no-build-isolation --editable .
	$(BIN)/python -m qcar_twin.vehicle.tyre.build
	$(BIN)/python -c "from qcar_twin.twin.engines.reduced.build import build; print(build().name)"
	touch $@

plugin: install
	$(BIN)/python -m qcar_twin.vehicle.tyre.build
	$(BIN)/python -c "from qcar_twin.twin.engines.reduced.build import build; print(build().name)"

clean:
	rm -rf $(VENV) out
