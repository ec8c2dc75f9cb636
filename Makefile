# Every target sets itself up in .venv first; nothing but Python (with venv) and make is needed.

PYTHON ?= python3
DATA   ?= $(or $(ENDOLAB_DATA),$(CURDIR)/../shared/data)
export ENDOLAB_DATA := $(DATA)

VENV  := .venv
BIN   := $(VENV)/bin
PIP   := $(BIN)/python -m pip --disable-pip-version-check
READY := $(VENV)/.ready

FRAME  := $(DATA)/c3vd_trans_t1_a/0001_color.png
NBVAL  := -p nbval -p tests.tools.notebook_timeouts -p tests.tools.notebook_solutions
NBVAL  += --runxfail --nbval-lax --nbval-current-env --timeout=0  # a cell has its own limit

.DEFAULT_GOAL := help
.PHONY: help lab demo test test-slow attack html lint bench unseen traced lock clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' Makefile

lab: $(READY) ## open JupyterLab on the notebooks
	$(BIN)/endolab lab

demo: $(READY) ## simulate a frame of a colon, reconstruct it, and compare it with its truth
	$(BIN)/endolab simulate colon --out demo --overwrite
	$(BIN)/endolab reconstruct demo/frame.png --calibration demo/endoscope.json --out demo/result --overwrite
	$(BIN)/endolab evaluate demo/result/depth.npz demo/truth.npz
	@if [ -f "$(FRAME)" ]; then \
	  set -x; $(BIN)/endolab reconstruct "$(FRAME)" --calibration c3vd --width 640 --out demo/real --overwrite; \
	fi
	@echo 'Look at:'
	@ls demo/frame.png demo/result/overview.png
	@if [ -f "$(FRAME)" ]; then ls demo/real/overview.png; fi

test: $(READY) ## run the tests, then every notebook with the solutions of its exercises
	@unset MPLBACKEND; export OPENBLAS_NUM_THREADS=1; status=0; \
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow and not lint" || status=1; \
	$(BIN)/python -m pytest -n 2 --dist loadfile $(NBVAL) notebooks || status=1; \
	exit $$status

test-slow: $(READY) ## test with a browser (screenshots: build/screenshots), kills, full disks, fresh environments
	@unset MPLBACKEND; export OPENBLAS_NUM_THREADS=1; $(BIN)/python -m pytest -n 2 --dist loadfile -m slow

attack: $(READY) ## damage files 2000 times each and kill every command 20 times (a quarter of an hour)
	@export OPENBLAS_NUM_THREADS=1 ENDOLAB_EXAMPLES=2000; $(BIN)/python -m pytest -n 2 --timeout 3600 tests/hostile

html: $(READY) ## render notebooks and a reference to build/html; with SOLUTIONS=1, the solutions are open
	@unset MPLBACKEND; $(BIN)/python -m tests.tools.render_pages notebooks build/html $(if $(SOLUTIONS),--solutions)
	@echo 'Look at build/html/index.html'

lint: $(READY) ## check style, format, spelling, types, imports, words and notebooks
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/lint

bench: $(READY) ## measure accuracy and speed
	$(BIN)/python -m tests.benchmarks.speed
	$(BIN)/python -m tests.benchmarks.accuracy
	$(BIN)/python -m tests.benchmarks.causes
	$(BIN)/python -m tests.benchmarks.uncertainty
	$(BIN)/python -m tests.benchmarks.paper
	$(BIN)/python -m tests.research.refit
	$(BIN)/python -m tests.research.light traced
	$(BIN)/python -m tests.benchmarks.lam

unseen: $(READY) ## score random frames that nobody tuned to; Mitsuba makes them first (20 minutes)
	$(PIP) install --quiet 'mitsuba>=3.9'
	$(BIN)/python -m tests.benchmarks.accuracy open

traced: $(READY) ## path-trace the frames anew, with Mitsuba (about 10 minutes)
	$(PIP) install --quiet 'mitsuba>=3.9'
	$(BIN)/python -m tests.research.make_traced_frames endolab/io/datasets/frames

lock: | $(BIN)/python ## renew requirements.lock from pyproject.toml
	$(PIP) install --quiet uv
	echo '# Versions known to work together, for Python 3.11 and newer; "make lock" renews them.' > $(VENV)/lock
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --extra lab --extra dev --no-header \
	  --no-annotate --no-emit-index-url --no-emit-find-links pyproject.toml >> $(VENV)/lock
	mv $(VENV)/lock requirements.lock

clean: ## delete what the other targets made, but for .venv
	rm -rf demo build *.egg-info .pytest_cache .ruff_cache .mypy_cache
	find endolab tests notebooks \( -name __pycache__ -o -name .ipynb_checkpoints \) -prune -exec rm -rf {} +

# uv is several times faster than pip; where it cannot be had, or cannot reach the packages, pip does it. What they
# install is byte-compiled, so that no first run does it, nor each where nothing can be kept; the loops beside it.
# `compat` puts the checkout on Python's path: a script beside it then imports the package, not the checkout's folder.
$(READY): requirements.lock pyproject.toml | $(BIN)/python
	@echo 'Setting up $(VENV): about 3 GB, and some minutes the first time.'
	@$(PIP) install --quiet uv && $(BIN)/uv pip install --quiet --python $(BIN)/python -r requirements.lock \
	  || $(PIP) install --quiet --no-compile -r requirements.lock
	@$(PIP) install --quiet --no-deps --no-build-isolation --config-settings editable_mode=compat -e .
	@$(BIN)/python -m endolab.cli.lab $(VENV)
	@echo 'Compiling packages and loops: a minute.'
	-@$(BIN)/python -m compileall -qq -j 2 endolab $(VENV)/lib & \
	  $(BIN)/endolab simulate colon --width 200 --out $(VENV)/first --overwrite >/dev/null 2>&1 && \
	  $(BIN)/endolab reconstruct $(VENV)/first/frame.png --calibration $(VENV)/first/endoscope.json \
	    --out $(VENV)/first/result --overwrite >/dev/null 2>&1; wait
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo 'endolab needs Python 3.11 or newer; name one with "make PYTHON=python3.11".' >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); exit 1; }
