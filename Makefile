# Everything makes its own .venv and installs what it needs; nothing has to be prepared by hand.
PYTHON ?= python3
BIN := .venv/bin
SCENE ?= skirt-hula
ARGS ?=

.PHONY: run test test-all lint docs tour dist bench soak peers lock audit clean

run: .venv/run.stamp  ## simulate the default scene: record it, show it, report on it
	@$(BIN)/nuno run $(SCENE) $(ARGS)

# Where Python may keep no bytecode, each of the hundreds of processes that tests start compiles all that it imports.
test test-all: export PYTHONDONTWRITEBYTECODE =

PYTEST := $(BIN)/pytest -n auto --dist loadfile --no-loadscope-reorder

test: .venv/dev.stamp  ## a test of every law, in minutes; those that need a missing system package skip by name
	$(PYTEST) -m "not full" $(ARGS)

test-all: .venv/dev.stamp  ## all tests: also those marked `full`, which take long and rarely break
	$(PYTEST) $(ARGS)

lint: .venv/dev.stamp  ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: .venv/dev.stamp  ## the documentation as a site, to be opened as a file; a warning fails it
	$(BIN)/python -m sphinx -q -W --keep-going docs build/docs $(ARGS)
	@echo "open build/docs/index.html"

tour: .venv/dev.stamp  ## how long each command of the README takes, into it
	$(BIN)/python docs/durations.py

dist: .venv/dev.stamp  ## a wheel and a source distribution, and their sizes
	$(BIN)/python -m hatchling build
	@cd dist && wc -c $$(ls -t | head -2)

bench: .venv/dev.stamp  ## speed against the measured bars, and the skirt paper's experiment
	$(BIN)/nuno bench speed $(ARGS)
	$(BIN)/nuno bench integrators skirt-paper

soak: .venv/dev.stamp  ## reliability at length, into its page: hours
	PYTHONPATH=tests:tests/services $(BIN)/python -m soak --docs docs/measured/reliability.md $(ARGS)

peers: .venv/dev.stamp  ## other engines: those that benchmarks and some tests compare with, and the path tracer
	$(call INSTALL,".[peers]")

lock: | .venv/bin/python  ## versions and hashes of all that a container installs
	$(BIN)/python -m pip install --disable-pip-version-check uv
	$(BIN)/uv pip compile pyproject.toml --universal --python-version 3.11 --upgrade \
		--generate-hashes --no-header --no-annotate --quiet --output-file deploy/requirements.txt

audit: | .venv/bin/python  ## known vulnerabilities of these versions
	$(BIN)/python -m pip install --disable-pip-version-check pip-audit
	$(BIN)/pip-audit --disable-pip --require-hashes --requirement deploy/requirements.txt

# By uv, which takes seven seconds for what takes pip forty-five; by pip where uv does not get there.
# Neither compiles all of 300 MB for Python, which takes twenty seconds: what is imported is compiled when it is.
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check uv \
	&& $(BIN)/uv pip install --python $(BIN)/python -e $(1) \
	|| $(BIN)/python -m pip install --no-compile --disable-pip-version-check -e $(1)

.venv/bin/python:
	@echo "making .venv with $$($(PYTHON) --version)"
	$(PYTHON) -m venv .venv

.venv/run.stamp: pyproject.toml | .venv/bin/python
	@echo "installing nuno and what it needs (460 MB to download, 1.5 GB on disk, once)"
	$(call INSTALL,".[video]")
	@touch $@

.venv/dev.stamp: pyproject.toml | .venv/bin/python
	@echo "installing nuno and what its tests need (more than 460 MB to download, once)"
	$(call INSTALL,".[dev]")
	@touch $@ .venv/run.stamp

clean:  ## remove the environment and caches, keep recordings
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache dist build
