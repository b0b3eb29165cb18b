# `make run` and `make test` do everything on a fresh Debian machine with Python 3.11.

PYTHON ?= python3
BIN := .venv/bin

.venv/installed-run: pyproject.toml requirements.lock
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet -c requirements.lock -e .
	touch $@
