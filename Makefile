# Every target sets up what it needs. On a fresh Debian: python3 (3.11+), python3-venv, make.

HOST ?= 127.0.0.1
PORT ?= 8000
# Data and documents beside the project; tests that need them skip where they are absent.
SHARED ?= ../shared
PYTHON ?= python3
export HOST PORT SHARED

# One environment to serve from, one to work in; a stamp file says when each was made.
RUN := .venv
DEV := .venv-dev
BUILD := .venv-build
NEWEST := .venv-newest
# MediaPipe wants another NumPy and another OpenCV than the service.
PEER := .venv-peer
RELEASE := .venv-release
REVISION := $(shell git rev-parse --short HEAD 2>/dev/null || echo unknown)

# pip is held to the versions that were tested; `make constraints` writes them.
PIP_INSTALL = pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: run test coverage test-all test-newest mutants check format index reranker paper evaluate bench results openapi constraints release clean

run: $(RUN)/.stamp
	POSE_REVISION=$${POSE_REVISION:-$(REVISION)} exec $(RUN)/bin/python -m app

# Three processes for two cores, since tests of servers and brokers often wait. A module stays in one:
# its tests share a server or an index. Compiled files are kept, also where the environment says
# otherwise: each process, and each program that a test starts, would else compile everything.
IN_PARALLEL := -q -n 3 --dist loadfile --no-loadscope-reorder
test coverage test-newest: export PYTHONDONTWRITEBYTECODE :=

test: $(DEV)/.stamp
	$(DEV)/bin/python -m pytest $(IN_PARALLEL) $(ARGS)

# The same tests; fails where they reach fewer branches than pyproject.toml says. Apart from `test`,
# since tracing takes a third more time.
coverage: $(DEV)/.stamp
	$(DEV)/bin/python -m pytest $(IN_PARALLEL) --cov $(ARGS)

# Also what is slow, and what needs an extra (torch, Milvus), ../shared or Chromium;
# -rs says which of them are missing.
test-all: $(BUILD)/.stamp
	$(BUILD)/bin/python -m pytest -q -rs -m "slow or not slow" $(ARGS)

# With the newest versions that pyproject.toml allows, in an environment of its own.
test-newest:
	@$(PYTHON) -m venv --clear $(NEWEST)
	@$(NEWEST)/bin/pip install --quiet --disable-pip-version-check -e '.[test]'
	$(NEWEST)/bin/python -m pytest $(IN_PARALLEL) $(ARGS)

# Not in continuous integration: a quarter of an hour.
mutants: $(DEV)/.stamp
	$(DEV)/bin/python -m scripts mutants $(ARGS)

check: $(DEV)/.stamp
	$(DEV)/bin/ruff check .
	$(DEV)/bin/ruff format --check .
	$(DEV)/bin/mypy

format: $(DEV)/.stamp
	$(DEV)/bin/ruff check --fix .
	$(DEV)/bin/ruff format .

# One thread for the linear algebra: with more, sums are added in another order, and the same
# inputs no longer give the same bytes. The rasteriser still takes all cores.
index: $(BUILD)/.stamp
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BUILD)/bin/python -m scripts build \
	  --mocap $(SHARED)/mocap --garments $(SHARED)/garments --name cmu-dressed --attribution cmu \
	  $(ARGS)

# One thread, for the same reason.
reranker: $(BUILD)/.stamp
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BUILD)/bin/python -m scripts train-reranker \
	  --mocap $(SHARED)/mocap --garments $(SHARED)/garments $(ARGS)

# The paper's experiments on the data that ships; Weizmann's where it lies.
paper: $(DEV)/.stamp
	$(DEV)/bin/$(PIP_INSTALL) -e '.[paper,test]'
	$(DEV)/bin/python -m scripts evaluate paper --shared $(SHARED) $(ARGS)

evaluate: $(BUILD)/.stamp
	$(BUILD)/bin/python -m scripts evaluate --shared $(SHARED) $(ARGS)

bench: $(DEV)/.stamp $(PEER)/.stamp
	$(DEV)/bin/python -m scripts bench --shared $(SHARED) $(ARGS)
	$(DEV)/bin/python -m scripts peer --shared $(SHARED) $(ARGS)

# All pages at one revision, a night at most; goes on where it was stopped.
results: $(BUILD)/.stamp
	$(BUILD)/bin/python -m scripts results $(ARGS)

openapi: $(DEV)/.stamp
	$(DEV)/bin/python -m scripts openapi

# The newest versions that pyproject.toml allows, to be tested before they are committed. What the
# extra build needs besides is pinned there.
constraints:
	@$(PYTHON) -m venv --clear $(NEWEST)
	@$(NEWEST)/bin/pip install --quiet --disable-pip-version-check \
	  -e '.[browser,cluster,contract,milvus,paper,test]'
	(head -n 2 $@.txt; $(NEWEST)/bin/pip freeze --all --exclude-editable --exclude pip --exclude setuptools) > $@.new
	mv $@.new $@.txt

# The wheel, and a bill of materials (CycloneDX) of what it installs, in dist.
release:
	rm -rf dist build
	@$(PYTHON) -m venv --clear $(RELEASE)
	@$(RELEASE)/bin/pip install --quiet --disable-pip-version-check cyclonedx-bom==7.5.0
	$(RELEASE)/bin/pip wheel --quiet --no-deps --wheel-dir dist .
	@$(PYTHON) -m venv --without-pip build/installed
	@$(RELEASE)/bin/pip --python build/installed/bin/python install --quiet \
	  --disable-pip-version-check --constraint constraints.txt dist/*.whl
	$(RELEASE)/bin/cyclonedx-py environment build/installed/bin/python --pyproject pyproject.toml \
	  --output-reproducible --output-file dist/silhouette-pose.cdx.json
	cd dist && sha256sum *.whl *.json > SHA256SUMS

$(RUN)/.stamp: pyproject.toml constraints.txt
	@echo "Once: setting up $(RUN) with what serving needs, from PyPI (about 20 s)"
	@$(PYTHON) -m venv $(RUN)
	@$(RUN)/bin/$(PIP_INSTALL) -e .
	@touch $@

$(DEV)/.stamp: pyproject.toml constraints.txt
	@echo "Once: setting up $(DEV) with what checks and tests need, from PyPI (about a minute)"
	@$(PYTHON) -m venv $(DEV)
	@$(DEV)/bin/$(PIP_INSTALL) -e '.[test]'
	@touch $@

# Where there is no wheel, the bench leaves its row out and says why.
$(PEER)/.stamp:
	@echo "Once: setting up $(PEER) with MediaPipe, from PyPI (about a minute)"
	@$(PYTHON) -m venv $(PEER)
	-@$(PEER)/bin/pip install --quiet --disable-pip-version-check mediapipe==0.10.21
	@touch $@

# torch first and pinned: another way round, pip takes gigabytes of CUDA libraries.
$(BUILD)/.stamp: pyproject.toml constraints.txt
	@echo "Once: setting up $(BUILD) with everything, torch too, from PyPI (several minutes)"
	@$(PYTHON) -m venv $(BUILD)
	@$(BUILD)/bin/$(PIP_INSTALL) torch==2.13.0
	@$(BUILD)/bin/$(PIP_INSTALL) -e '.[browser,build,cluster,contract,milvus,paper,test]'
	@touch $@

# All that the targets above and `pip install .` leave behind; no other file is touched.
clean:
	rm -rf $(RUN) $(DEV) $(BUILD) $(NEWEST) $(PEER) $(RELEASE) build dist *.egg-info \
	  .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage mutants
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
