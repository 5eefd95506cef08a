PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
DEMO ?= demo-out
WORKERS ?= 2
N ?= 2000
CROSS ?= cross-rig
PAPER_RIGS := 4x95 5x75 5x70+110 6x60 6x70 6x80a 6x80b 8x50

.DEFAULT_GOAL := help
.PHONY: help install test check convert demo bench chaos optimise fuzz cross-rig cross-rig-quick clean

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

optimise: install     ## find rigs/unidrive-optimised-6.yaml anew
	$(BIN)/unidrive synth $(DEMO)/boxes --rig benchmarks/boxes-only.yaml --scenes 12 --keyframes 20 --seed 7
	$(BIN)/unidrive optimize-rig $(PAPER_RIGS) --boxes $(DEMO)/boxes \
		--search rigs/searches/unidrive-optimised-6.yaml --out rigs/unidrive-optimised-6.yaml --force

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
	rm -rf $(VENV) $(DEMO) $(CROSS)-quick $(CROSS)-full .pytest_cache .mypy_cache .ruff_cache
