# Needs Python 3.11 to 3.13 (PYTHON=...), make and git; everything else goes into $(VENV).

PYTHON ?= python3
VENV ?= .venv
WORKERS ?= 2
RIGS ?= one_joint two_joint six_joint
OUT ?= out
CACHE ?= $(OUT)/studies
FUZZ_SECONDS ?= 60
MUTANTS ?= 12

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DELETE_ON_ERROR:
.SECONDEXPANSION:
.SUFFIXES:

# One thread of BLAS: results repeat to the last bit, and workers do not compete for cores.
export OPENBLAS_NUM_THREADS ?= 1
# Bytecode is kept: without it each of many commands compiles the package anew.
unexport PYTHONDONTWRITEBYTECODE

BIN := $(VENV)/bin
RUN := $(VENV)/.installed
DEV := $(VENV)/.installed-dev
SEQID := $(BIN)/seqid
LOCK := .ci/requirements.txt
TOOLS := $(VENV)-tools/.installed
UV := $(VENV)-tools/bin/uv
OLDEST := $(VENV)-oldest/.installed
RELEASE := $(VENV)-release/.installed

.PHONY: help
help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/\1\t\2/p' $(MAKEFILE_LIST) | expand -t 15

# ---- environment

$(BIN)/python:
	$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v < (3, 14) else f"Python 3.11 to 3.13 is needed, this is {v[0]}.{v[1]}: set PYTHON=")'
	$(PYTHON) -m venv $(VENV)

$(RUN): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(DEV): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@ $(RUN)

.PHONY: locked
locked: $(LOCK) | $(BIN)/python ## install what is locked, by its hashes, instead of the newest
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement $(LOCK)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $(DEV) $(RUN)

$(TOOLS): | $(BIN)/python
	$(BIN)/python -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet --disable-pip-version-check \
		uv pip-audit cyclonedx-bom pip-licenses cosmic-ray
	touch $@

.PHONY: lock audit
lock: $(TOOLS) ## lock the dependencies anew: the newest that pyproject.toml allows
	echo 'hatchling>=1.24' | $(UV) pip compile pyproject.toml - --extra dev --universal --python-version 3.11 \
		--upgrade --generate-hashes --no-annotate --no-header --no-emit-index-url --no-emit-find-links --quiet --output-file $(LOCK)

audit: $(TOOLS) ## look the locked dependencies up in the list of known holes
	@said=$$($(dir $(TOOLS))bin/pip-audit --strict --require-hashes --disable-pip --requirement $(LOCK) 2>&1) && code=0 || code=$$?; \
	echo "$$said"; case "$$said" in *ERROR*) \
		echo "not audited: the advisory data base cannot be reached from this machine, or does not know a dependency" >&2;; \
	esac; exit $$code

# What `pip install seqid` installs, and nothing else: the parts of a release.
$(RELEASE): pyproject.toml $(LOCK) $(TOOLS)
	$(UV) venv --quiet --allow-existing --python $(BIN)/python $(@D)
	$(UV) pip install --quiet --python $(@D)/bin/python --constraint $(LOCK) .
	touch $@

.PHONY: sbom licences
sbom: $(RELEASE) ## list the parts of a release with versions and licences, as CycloneDX, into $(OUT)/sbom.json
	mkdir -p $(OUT)
	$(dir $(TOOLS))bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible \
		--output-file $(OUT)/sbom.json $(dir $(RELEASE))bin/python

licences: $(RELEASE) ## list the licences of all dependencies anew, in docs/reference/licences.md
	$(dir $(TOOLS))bin/pip-licenses --python $(dir $(RELEASE))bin/python --from mixed --format markdown --with-urls \
		--ignore-packages seqid \
		| $(BIN)/python -m tests.unit.docs.licences

# ---- checks

# A file stays with one worker: what its tests share is made once. tests/conftest.py says which come first.
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

.PHONY: test test-all test-oldest docs-test lint types
test: $(DEV) ## run the tests, apart from those that take long
	$(PYTEST) -m 'not slow'

test-all: $(DEV) ## run every test
	$(PYTEST)

$(OLDEST): pyproject.toml $(TOOLS)
	$(UV) venv --quiet --allow-existing --python $(BIN)/python $(@D)
	$(UV) pip install --quiet --python $(@D)/bin/python --resolution lowest-direct --editable '.[dev]'
	touch $@

test-oldest: $(OLDEST) ## run the tests with the oldest dependencies that are allowed
	$(dir $(OLDEST))bin/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder -m 'not slow'

docs-test: $(DEV) ## run every command of the documents, also those that take minutes
	SEQID_DOCS=1 $(BIN)/python -m pytest tests/unit/docs

lint: $(DEV) ## check the style and the spelling
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/codespell

types: $(DEV) ## check the types
	$(BIN)/mypy

.PHONY: study
study: $(DEV) ## measure against truth and bounds, rewrite the tables in docs/evidence/{measured,recorded}.md (minutes)
	$(BIN)/python -m tests.studies

.PHONY: study-effects
study-effects: $(DEV) ## how well undeclared effects are found, into docs/evidence/effects_study.md (hours)
	$(BIN)/python -m tests.studies --only undeclared --processes $(WORKERS)

.PHONY: study-coverage
study-coverage: $(DEV) ## do the stated errors hold: 200 drawn arms of each kind, into docs/evidence/coverage.md (hours)
	$(BIN)/python -m tests.studies --only coverage --processes $(WORKERS)

.PHONY: study-plan
study-plan: $(DEV) ## predicted errors and pairs told apart against plants, into docs/evidence/planned.md (an hour)
	$(BIN)/python -m tests.studies --only planned_errors planned_separation --cache $(CACHE)

.PHONY: study-outside
study-outside: $(DEV) ## cases of the second simulator, into docs/evidence/outside.md (20 s a case)
	$(BIN)/python -m tests.studies.outside --set tuning --seeds 0:110 --cache $(OUT)/outside --write

.PHONY: study-truth
study-truth: $(DEV) ## does `good` mean good: tuning arms with imperfections on the screen, one arm and the rigs into docs/evidence/truth_study.md (10 s an arm)
	$(BIN)/python -m tests.studies.truth --set tuning --seeds 0:40 --cache $(OUT)/truth --processes $(WORKERS)
	$(BIN)/python -m tests.studies.truth --set tuning --seeds 0:64 --alone --cache $(OUT)/truth --processes $(WORKERS)
	$(BIN)/python -m tests.studies.truth --fixed --seeds 0 --cache $(OUT)/truth --processes $(WORKERS) --write
	$(BIN)/python -m tests.studies.truth --rigs --seeds 0:2 --cache $(OUT)/truth --processes $(WORKERS) --write

.PHONY: bench
bench: $(DEV) ## measure CPU time and memory, rewrite the tables in docs/evidence/benchmarks.md (minutes)
	$(BIN)/python -m tests.studies --only ingestion fixed inspected beside_figaroh over_size kernels whole_run smoother discovery exported_step

.PHONY: fuzz
fuzz: $(DEV) ## read damaged files of every kind for FUZZ_SECONDS; finds go to $(OUT)/fuzz
	$(BIN)/python -m tests.studies.fuzz --seconds $(FUZZ_SECONDS) --seed $$RANDOM --keep $(OUT)/fuzz

.PHONY: study-trust
study-trust: $(DEV) ## damaged files, kills, slow and many logs, two hours of log, into docs/evidence/damage.md (hours)
	$(BIN)/python -m tests.studies.fuzz --readers --count 10000 --keep $(OUT)/fuzz --write
	$(BIN)/python -m tests.studies.fuzz --count 10000 --keep $(OUT)/fuzz --write
	$(BIN)/python -m tests.studies.kills --write
	$(BIN)/python -m tests.studies.many_logs --write
	$(BIN)/python -m tests.studies.slow_files --write
	$(BIN)/python -m tests.studies.soak --write

.PHONY: mutants
mutants: $(DEV) $(TOOLS) ## change the modules that decide, MUTANTS places in each: do their fast tests notice (minutes to hours)
	$(dir $(TOOLS))bin/python tests/studies/mutants.py --python $(BIN)/python --each $(MUTANTS)

# ---- the documents as a site

DOCS := $(VENV)-docs/.installed
PAGES := README.md CONTRIBUTING.md CHANGELOG.md SECURITY.md CITATION.cff LICENSE Makefile docs sample_logs/README.md \
	.github/workflows/seqid.yml

$(DOCS): pyproject.toml | $(BIN)/python
	$(BIN)/python -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

.PHONY: docs notebook
docs: $(DOCS) ## make the site of the documents in out/site (its search needs a server: python -m http.server -d out/site)
	rm -rf out/pages && mkdir -p out/pages
	cp --parents -r $(PAGES) out/pages
	cp .ci/reference.md out/pages/docs/reference/functions.md
	$(dir $(DOCS))bin/mkdocs build --strict --config-file .ci/mkdocs.yml

notebook: $(DOCS) ## run docs/tutorial/notebook.ipynb, keep its outputs
	$(dir $(DOCS))bin/python -m tests.unit.docs.run_notebook

# ---- sample logs

.PHONY: samples
samples: $(DEV) ## make sample_logs/ anew (simulated, seeded)
	$(BIN)/python -m tests.plants.samples sample_logs

# ---- demo: sample_logs/ from logs to reports

RUN_LOGS := friction gravity imu inertia validation
# $(call logs,FOLDERS): the logs of a rig's folders, so that a new log makes its results again
logs = $$(foreach folder,$(1),$$(wildcard sample_logs/$$*/$$(folder)/*))

REPORTS := $(RIGS:%=$(OUT)/%/report.html)
REFINED := $(RIGS:%=$(OUT)/%/refined.html)

.PHONY: demo demo-refine
demo: $(REPORTS) $(filter $(OUT)/two_joint/%,$(REFINED)) ## identify the sample robots, refine one that has changed
	@$(if $(word 2,$^),echo 'more reports: $(filter-out $(lastword $^),$^)')
	@echo 'refine the other robots as well: make demo-refine'
	@echo 'open this page: $(lastword $^)'

demo-refine: $(REFINED) ## refine all sample robots, each of which has changed (minutes)

$(OUT)/%/report.html: sample_logs/%/robot.toml $(call logs,$(RUN_LOGS)) | $(RUN)
	$(SEQID) run sample_logs/$* -r $< -o $(@D) --no-refine

$(OUT)/%/inertia.json: $(OUT)/%/report.html ;

# Then something on the arm changed that its robot file does not say: what, and a model with it.
$(OUT)/%/refined.html: sample_logs/%/robot.toml $(OUT)/%/report.html $(call logs,changed) | $(RUN)
	$(SEQID) diagnose sample_logs/$*/changed -r $< -p $(@D)/inertia.json -o $(@D)/changed_diagnosis.json
	$(SEQID) refine sample_logs/$*/changed/fourier.parquet sample_logs/$*/changed/trapezoids.parquet \
		--holdout sample_logs/$*/changed/held_out.parquet -r $< -p $(@D)/inertia.json -o $(@D)/refined.json --strict
	for model in inertia refined; do \
		$(SEQID) predict sample_logs/$*/changed/held_out.parquet -r $< -p $(@D)/$$model.json \
			-o $(@D)/$$model-held_out.json --torques $(@D)/$$model-held_out.parquet; \
	done
	$(SEQID) report $(@D)/{inertia,refined,changed_diagnosis,inertia-held_out,refined-held_out}.json \
		$(@D)/{inertia,refined}-held_out.parquet -o $@
	@echo '$*: diagnose named what changed, refine added it, the held-out log confirms it'

.PHONY: pictures
pictures: $(OUT)/two_joint/refined.html ## take the pictures of docs/how-to/report.md anew (needs chromium)
	$(BIN)/python -m tests.unit.report.browser $< docs/images

# ---- regression: the demo's models against those that are kept in sample_logs/

GOLDEN ?= one_joint two_joint
FORMAT ?= text

.PHONY: golden golden-update
golden: $(GOLDEN:%=$(OUT)/%/inertia.json) ## compare the identified models with the golden ones
	@status=0; for rig in $(GOLDEN); do \
		$(SEQID) compare sample_logs/$$rig/golden.json $(OUT)/$$rig/inertia.json --format $(FORMAT) \
			|| status=$$?; \
	done; exit $$status

golden-update: $(GOLDEN:%=$(OUT)/%/inertia.json) ## keep the identified models as the golden ones
	for rig in $(GOLDEN); do cp $(OUT)/$$rig/inertia.json sample_logs/$$rig/golden.json; done

# ---- the rest

.PHONY: clean
clean: ## remove what was made, apart from the environment
	rm -rf $(OUT) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
