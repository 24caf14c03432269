# Everything a user or a developer runs. Each target makes .venv itself: only Python >= 3.11 and make are needed.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
DEMO   := $(VENV)/.installed-demo
TEST   := $(VENV)/.installed-test
DOCS   := $(VENV)/.installed-docs

unexport PYTHONDONTWRITEBYTECODE   # of a container: each worker would compile the whole suite, each time

# A run of the same code is the same run; SEARCH=1: random examples and hashes, as by night
export PYTHONHASHSEED := $(if $(SEARCH),random,0)
export SKYGCS_TEST_SEARCH := $(SEARCH)

.PHONY: quick test-times test-deep mutants coverage
.PHONY: demo test test-system test-lab test-package test-container test-clients test-firmware check docs bench bench-control bench-radio bench-xbee bench-plans bench-monitor bench-formation bench-invariant bench-web bench-ros bench-federation figures test-federation test-ros soak fuzz clean format web dist test-web pictures
demo: $(DEMO)
	$(BIN)/python build_page.py --or-warn
	$(BIN)/skygcs demo

# The web page, with Node >= 20 from PATH or fetched into build/
web: $(STAMP)
	$(BIN)/python build_page.py

# Wheel and source package, with the built page in both
dist: $(STAMP)
	$(BIN)/python build_page.py
	$(BIN)/python -m build

test: $(TEST)
	$(BIN)/pytest -n auto --dist worksteal tests/unit tests/integration $(if $(PASSED),--passed-to $(PASSED))

# Those of them that the work since main touches: BASE=<commit> compares with another commit
quick: $(TEST)
	BASE=$(BASE) PYTHONPATH=tests $(BIN)/python -m quick

# make test with a table of CPU and wall time of each file; one above 5 s without a reason ends it
test-times: $(TEST)
	$(BIN)/pytest -n auto --dist worksteal tests/unit tests/integration --costs

# One-line changes of safety code that its unit tests must notice: ROOM=routing; SAMPLE=50, or ARGS=--all
mutants: $(TEST)
	PYTHONPATH=tests $(BIN)/python -m mutants $(ROOM) --sample $(or $(SAMPLE),100) $(ARGS)

# make test with the share of lines and of branches that it executes, the least covered files first. ROOM=core/mission: of
# one folder of src/skygcs by its own unit tests, in seconds
coverage: $(STAMP)
	$(BIN)/pytest -q -n auto --dist worksteal $(if $(ROOM),tests/unit/$(ROOM) --cov=src/skygcs/$(ROOM),tests/unit tests/integration --cov) --cov-report=term

# make test at length: whole tables, all seeds, ten times the examples, the other event loop; EXAMPLES=100 SEARCH=1.
# PASSED=file: `make test PASSED=file` notes there what it passed, and this leaves it out. SHARE=0/3: the first third
test-deep: $(TEST)
	SKYGCS_TEST_EXAMPLES=$(or $(EXAMPLES),10) $(BIN)/pytest -n auto --dist worksteal tests/unit tests/integration --deep $(if $(PASSED),--passed-before $(PASSED)) $(if $(SHARE),--share $(SHARE))

# Real processes, sockets and ptys in real time: most of it is waiting
test-system: $(TEST)
	$(BIN)/pytest -n auto --dist worksteal tests/system

# MAVSDK (3 over gRPC, and 4), DroneKit, MAVProxy and pymavlink themselves, each in an environment of its own
test-clients: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m clients.environments
	$(BIN)/pytest tests/clients -n 8 --dist worksteal

# The built wheel and sdist, installed in empty folders of their own: what a user of the package index gets
test-package: $(STAMP)
	PYTHONPATH=tests $(BIN)/pytest tests/package -s

# The Containerfile's steps in empty roots, without a container runtime: root and debootstrap; MIRROR=http://… of Debian
test-container: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m container

# The page and the documentation in a real browser: the system's Chromium. Pictures: build/web-screens. Most of it is
# waiting; a file's tests share their stations, so each file stays in one worker
test-web: $(STAMP)
	$(BIN)/python build_page.py --check
	$(MAKE) docs
	$(BIN)/pytest -n auto --dist loadfile tests/web

# The pictures of README and docs, from the real page with simulated vehicles: docs/images/web-*.png
pictures: $(STAMP)
	$(BIN)/python build_page.py
	PYTHONPATH=tests $(BIN)/python tests/web/pictures.py

# Programs of a lab (a real Prometheus, SSH servers), of which it names those that are missing; LAB_SCRAPES=24
test-lab: $(TEST)
	PYTHONPATH=tests $(BIN)/python -m lab

# Many stations over a real nats-server, whose package it names if it is missing
test-federation: $(TEST)
	PYTHONPATH=tests $(BIN)/python -m federation

# Fast DDS programs, built here from the same interfaces, fly simulated vehicles; it names packages that are missing
test-ros: $(TEST)
	PYTHONPATH=tests $(BIN)/python -m ros

# Real autopilots: SKYGCS_PX4 and SKYGCS_ARDUCOPTER name the binaries; FULL=1: also what takes minutes
test-firmware: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m firmware $(if $(FULL),--full)

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry src --optional-dependencies-dev-groups test,docs,dev
	$(BIN)/deptry src tests/unit tests/integration tests/system tests/support
	@if command -v npm >/dev/null; then $(BIN)/python build_page.py --check; else echo "no npm in PATH: make test-web checks the page"; fi

# The documentation as a site: build/site/index.html, to be opened as a file. A broken link ends it
docs: $(DOCS)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

bench: $(STAMP)
	$(BIN)/python -m pytest tests/bench -s --timeout 600

bench-control: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m bench.control

bench-radio: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m bench.radio

bench-xbee: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m bench.xbee

bench-plans: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m bench.plans

bench-monitor: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m bench.monitor

bench-formation: $(STAMP)   # FORMATION_ENCOUNTERS=10000
	PYTHONPATH=tests $(BIN)/python -m bench.formation --encounters $(or $(FORMATION_ENCOUNTERS),10000)

bench-invariant: $(STAMP)   # INVARIANT_FLIGHTS=1000 INVARIANT_FIRST=0
	PYTHONPATH=tests $(BIN)/python -m bench.invariant --flights $(or $(INVARIANT_FLIGHTS),1000) --first $(or $(INVARIANT_FIRST),0)

bench-web: $(STAMP)
	$(BIN)/python build_page.py
	PYTHONPATH=tests $(BIN)/python -m bench.web

# Ten vehicles at 50 Hz as topics of ROS 2, and the rates behind a radio
bench-ros: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m bench.ros

bench-federation: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m bench.federation

# Size, rooms, equal lines, imports of a plain daemon, an order's way to the wire; OpenRPC and --help for a diff: build/figures
figures: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m figures

soak: $(STAMP)   # SOAK_MINUTES=60 SOAK_VEHICLES=20 SOAK_RATE=2000 SOAK_SEED=1
	PYTHONPATH=tests $(BIN)/python -m bench.soak

fuzz: $(STAMP)   # FUZZ_DATAGRAMS=1000000, or FUZZ_SECONDS=45; FUZZ_SEED=0 FUZZ_JOBS=1
	PYTHONPATH=tests $(BIN)/python -m fuzz.fast_path

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Anew when the package list, the build or the C changes: a stale fast path would be tested instead. Each installs only
# what its targets need; what is there for more serves the others, too. Not compiled: most of it is never imported.
BUILT_FROM := pyproject.toml hatch_build.py $(wildcard src/skygcs/links/_fast_path*.[ch])
INSTALL = test -x $(BIN)/python || $(PYTHON) -m venv $(VENV); $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check -e

$(STAMP): $(BUILT_FROM)
	$(INSTALL) '.[dev]'
	touch $@ $(TEST) $(DEMO) $(DOCS)

$(TEST): $(BUILT_FROM)
	$(INSTALL) '.[test]'
	touch $@ $(DEMO)

$(DOCS): $(BUILT_FROM)
	$(INSTALL) '.[docs]'
	touch $@

$(DEMO): $(BUILT_FROM)
	$(INSTALL) '.[web]'
	touch $@

clean:
	rm -rf $(VENV) src/skygcs/web/static src/skygcs/web/page/node_modules build dist .pytest_cache .mypy_cache .ruff_cache
