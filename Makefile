# make demo | test | sequences | gui | lint | bench [ONLY=…] | chart | charts [ONLY=…] | failures | caustics | pictures | preview | samples | package | clean      PYTHON=… picks the interpreter (3.11 or 3.13)
PYTHON ?= $(shell for p in python3.13 python3.11 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 13)))' 2>/dev/null && echo $$p && break; done)
VERSION := $(shell $(PYTHON) -c 'import sys; print("%d%d" % sys.version_info[:2])' 2>/dev/null)
VENV := .venv$(VERSION)
RUN := $(VENV)/bin/python
LOCK := requirements/py$(VERSION).lock
ONLY ?=

.PHONY: demo test sequences gui lint bench samples chart charts failures caustics pictures preview package clean venv locked

demo: venv
	$(RUN) sample_blends/demo.py

test: lint
	$(RUN) -m pytest tests/core -q
	$(RUN) -m pytest tests/addon -q

gui: venv
	$(RUN) -m pytest tests/gui -q -rs

sequences: venv
	LIGHTPANES_SEQUENCES=200 $(RUN) -m pytest tests/addon/test_sequences.py -q

lint: venv
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

bench: venv
	$(RUN) -m tests.bench $(ONLY)

chart: venv
	$(RUN) -m lightpanes chart sample_blends/cornell.blend --resolution 128 --output out/chart

charts: venv
	$(RUN) -m tests.bench.all_charts $(ONLY)

failures: venv
	$(RUN) -m tests.failures

caustics: venv
	$(RUN) sample_blends/caustics.py

pictures: venv
	$(RUN) -m tests.gui

preview: venv
	$(RUN) -m tests.bench.preview_picture

samples: venv
	$(RUN) sample_blends/build.py

package: venv
	$(RUN) -m package

venv: $(VENV)/.ready

locked: $(VENV)/.locked

$(VENV)/.ready: $(VENV)/.locked pyproject.toml
	$(RUN) -m pip install --quiet --no-deps --editable .
	touch $@

$(VENV)/.locked: $(LOCK)
	@test -n "$(VERSION)" || { echo "No Python 3.11 or 3.13 found; install one, or say make PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --no-compile --requirement $(LOCK)
	touch $@

$(LOCK):
	@echo "Lightpanes runs on Python 3.11 (Blender 4.5 LTS) and 3.13 (Blender 5.2 LTS); '$(PYTHON)' is neither. Say make PYTHON=python3.11"; exit 1

clean:
	rm -rf out .venv* build *.egg-info
