PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO ?= demo-out
WORKERS ?= 2
N ?= 2000
CROSS ?= cross-rig
# Readers of datasets; the second line is what they need of what they name, which is often an older numpy or OpenCV.
READERS := mmdet3d==1.4.0 mmdet==3.3.0 mmcv-lite==2.1.0 mmengine==0.10.7 vis4d==1.0.0
READERS_NEED := torch==2.13.0 addict yapf termcolor rich pyyaml terminaltables pycocotools scipy six trimesh plyfile \
	ml_collections tabulate utm h5py
READERS_BIN := $(VENV)-consumers/bin
PAPER_RIGS := 4x95 5x75 5x70+110 6x60 6x70 6x80a 6x80b 8x50

.DEFAULT_GOAL := help
.PHONY: help install test check convert demo bench chaos optimise consumers fuzz cross-rig cross-rig-quick clean

help:                 ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1	/p' $(MAKEFILE_LIST)

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	touch $@

install: $(VENV)/.installed   ## make .venv and install unidrive into it

test: install         ## run all tests
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadfile $(PYTEST)

check: install        ## ruff and strict mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

convert: install      ## make convert SRC=dataset DST=output RIG=roof-6x70
	@test -n "$(SRC)" -a -n "$(DST)" -a -n "$(RIG)" || { echo 'usage: make convert SRC=dataset DST=output RIG=roof-6x70'; exit 2; }
	$(BIN)/unidrive convert "$(SRC)" "$(DST)" --rig "$(RIG)"

demo: install         ## render a small drive, convert it, say where to look
	rm -rf $(DEMO)/source $(DEMO)/converted
	$(BIN)/unidrive synth $(DEMO)/source --rig 5x70+110 --scenes 2 --keyframes 2
	$(BIN)/unidrive convert $(DEMO)/source $(DEMO)/converted --rig roof-6x70
	$(BIN)/python -m tests.contact_sheet $(DEMO)/source $(DEMO)/converted $(DEMO)/contact-sheet.jpg
	@echo
	@echo 'Open $(DEMO)/contact-sheet.jpg: the source cameras above, the virtual ones with their boxes below.'
	@echo 'The converted dataset is $(DEMO)/converted; read its TRAINING.md, or try:'
	@echo '  $(BIN)/unidrive inspect-rig $(DEMO)/converted'
	@echo '  $(BIN)/unidrive convert $(DEMO)/source $(DEMO)/another --rig 8x50'

bench: install        ## CPU time of a sample against the codec alone
	$(BIN)/python benchmarks/convert_vs_codec.py

chaos: install        ## kill 50 conversions with kill -9, resume each, compare the bytes
	$(BIN)/python -m tests.chaos --kills 50

optimise: install     ## find rigs/unidrive-optimised-6.yaml and rigs/unidrive-fleet-6.yaml anew
	$(BIN)/unidrive synth $(DEMO)/boxes --rig benchmarks/boxes-only.yaml --scenes 12 --keyframes 20 --seed 7
	for rig in unidrive-optimised-6 unidrive-fleet-6; do \
		$(BIN)/unidrive optimize-rig $(PAPER_RIGS) --boxes $(DEMO)/boxes \
			--search rigs/searches/$$rig.yaml --out rigs/$$rig.yaml --force || exit; \
	done

$(VENV)-consumers/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)-consumers
	$(READERS_BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	$(READERS_BIN)/python -m pip install --quiet --disable-pip-version-check 'numpy<2' $(READERS_NEED) && \
		$(READERS_BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps $(READERS) || \
		echo 'Not all readers can be installed here; those that are missing will be skipped.'
	touch $@

consumers: $(VENV)-consumers/.installed   ## let nuscenes-devkit, mmdetection3d and vis4d read a converted drive
	rm -rf $(DEMO)/consumers
	$(READERS_BIN)/unidrive synth $(DEMO)/consumers/source --rig 6x80a --scenes 2 --keyframes 2 --val-share 0.5
	$(READERS_BIN)/unidrive convert $(DEMO)/consumers/source $(DEMO)/consumers/converted --rig roof-6x70
	$(READERS_BIN)/python -m benchmarks.consumers $(DEMO)/consumers/converted

fuzz: install         ## break datasets, rigs and pictures: make fuzz N=20000
	$(BIN)/python -m tests.fuzzing $(N)

$(VENV)/.proof: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev,proof]'
	touch $@

cross-rig-quick: $(VENV)/.proof   ## train two small detectors, test them on four rigs, raw and converted (15 minutes)
	$(BIN)/python -m benchmarks.cross_rig quick --work $(CROSS)-quick --workers $(WORKERS)
	$(BIN)/python -m benchmarks.cross_rig.report $(CROSS)-quick --figure $(CROSS)-quick/figure.png

cross-rig: $(VENV)/.proof   ## the tables of docs/results.md (4 hours; the same command continues)
	$(BIN)/python -m benchmarks.cross_rig full --work $(CROSS)-full --workers $(WORKERS)
	$(BIN)/python -m benchmarks.cross_rig.report $(CROSS)-full --figure $(CROSS)-full/figure.png

clean:                ## remove what make made
	rm -rf $(VENV) $(VENV)-consumers $(DEMO) $(CROSS)-quick .pytest_cache .mypy_cache .ruff_cache
