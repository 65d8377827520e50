# Two targets do everything on a fresh machine with Python 3.11: `make run` and `make test`.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/sample

.PHONY: run test check train install plugin clean

run: install
	$(BIN)/python scripts/main.py --dataset data/sample --out $(OUT)

test: install
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2

check: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

train: install
	$(BIN)/python scripts/train.py --out out/train

install: $(VENV)/installed

# torch by itself and pinned: installed through another package's wish it drags in GPU packages
$(VENV)/installed: requirements.lock pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet -r requirements.lock
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	$(BIN)/python -m qcar_twin.tyre.build
	touch $@

plugin: install
	$(BIN)/python -m qcar_twin.tyre.build

clean:
	rm -rf $(VENV) out
