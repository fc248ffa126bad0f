PYTHON ?= python3
BIN := .venv/bin

# Tests of commands, robots, sweeps and examples, without the checks of argument types, as for users.
# Some wait for robots and workers, so they have one more process.
AS_USERS := tests/cli tests/faults tests/fuzz tests/golden tests/robot tests/sweep tests/test_doctests.py
PLAIN := -o addopts="--strict-config --strict-markers --import-mode=importlib"
UNCHECKED := $(PLAIN) $(AS_USERS)
# NumPy, BLAS and XLA use the instructions of a processor without AVX-512 on every machine.
AVX2 := OPENBLAS_CORETYPE=Haswell XLA_FLAGS=--xla_cpu_max_isa=AVX2 \
	NPY_DISABLE_CPU_FEATURES="X86_V4 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"

# Packages are installed without bytecode, so Python must be able to write it.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo robot test test-avx2 test-all fuzz faults lint bench docs pictures clean

demo: .venv/.runtime
	$(BIN)/jaxcell demo --out runs/demo

# Only the packages to run a filter or a plan on a robot: 96 MB in place of 1,650.
robot: .venv/bin/python
	$(BIN)/python -m pip install --quiet --group robot
	$(BIN)/python -m pip install --quiet --no-deps --editable .

test: .venv/.dev
	$(BIN)/pytest -n 2 --dist loadfile $(AS_USERS:%=--ignore %)
	$(BIN)/pytest -n 3 --dist loadfile $(UNCHECKED)

# FOLDERS selects folders in place of the golden cases: FOLDERS="tests/markov tests/patrol"
test-avx2: .venv/.dev
	$(AVX2) $(BIN)/pytest -n 2 $(if $(FOLDERS),--dist loadfile $(FOLDERS),$(PLAIN) tests/golden)

test-all: .venv/.dev
	XLA_FLAGS= $(BIN)/pytest --hypothesis-profile whole -n 2 --dist loadfile $(AS_USERS:%=--ignore %)
	XLA_FLAGS= $(BIN)/pytest --hypothesis-profile whole -n 2 --dist loadfile $(UNCHECKED)
	XLA_FLAGS= JAX_ENABLE_X64=0 $(BIN)/pytest tests/test_without_x64.py

fuzz: .venv/.dev
	JAXCELL_FUZZ=2000 $(BIN)/pytest tests/fuzz

faults: .venv/.dev
	JAXCELL_FAULTS=1 $(BIN)/pytest $(PLAIN) -n 2 tests/faults

lint: .venv/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy tests/typing
	$(BIN)/pyright --pythonpath $(BIN)/python tests/typing
	$(BIN)/lint-imports

bench: .venv/.bench
	$(BIN)/python experiments/benchmarks/run.py $(if $(JSON),--json "$(JSON)")

docs: .venv/.dev
	$(BIN)/mkdocs build --config-file docs/mkdocs.yml

pictures: .venv/.dev
	$(BIN)/python data/pictures/make_figures.py
	$(BIN)/python data/pictures/make_plots.py
	$(BIN)/python data/pictures/make_pictures.py

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and f"jaxcell needs Python 3.11 or newer, and this is {sys.version.split()[0]}; name one with make PYTHON=...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade "pip>=25.1"

# Without bytecode the installation is faster, because most modules are never imported.
.venv/.runtime: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[app]"
	touch $@

.venv/.dev: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --no-compile --editable ".[app]" --group dev
	touch $@

.venv/.bench: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --editable ".[app,cluster]" --group bench
	touch $@

clean:
	rm -rf .venv runs docs/site
