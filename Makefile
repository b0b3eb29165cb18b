# `make run` and `make test` do everything on a fresh Debian machine with Python 3.11.

PYTHON ?= python3
BIN := .venv/bin
SUDO := $(if $(filter 0,$(shell id -u)),,sudo)
PYTHON_CODE := hil firmware_sim design tests
SOURCES_OF_INSTALL := pyproject.toml requirements.lock $(wildcard firmware_sim/arm/*.c hil/host/vcan/*.c)

# On small matrices, threads of the linear algebra cost more than they gain, beside two test processes above all.
export OPENBLAS_NUM_THREADS = 1

.SILENT:
.PHONY: run test coverage test-examples fuzz mutants soak bench lock clean run-packages test-packages

run: .venv/for-run
	$(BIN)/hil run

test: .venv/for-test test-packages tests/node/node_modules
	$(BIN)/ruff check --quiet $(PYTHON_CODE)
	$(BIN)/ruff format --check --quiet $(PYTHON_CODE)
	$(BIN)/mypy & types=$$!; PYTHONPATH=tests $(BIN)/python -m fuzz --inputs 300000 && wait $$types
	$(BIN)/python -m pytest -q -n 2 -m "not real_time" tests/acceptance tests/property tests/fuzz tests/mutants tests/unit
	PYTHONPATH=tests $(BIN)/python -m mutants --sample 150 --seconds 60
	$(BIN)/hil vcan -- $(BIN)/python -m pytest -q tests/vcan
	$(BIN)/python -m pytest -q -m real_time tests/acceptance
	$(MAKE) test-examples

# Which lines the unit tests reach, with a lower bound. Tracing doubles their time, so that `make test` omits it.
coverage: .venv/for-test
	$(BIN)/python -m pytest -q -n 2 --cov --cov-report=term:skip-covered tests/unit

# Users' tests run where only the wheel is installed. Its dependencies are those of .venv: a .pth file makes
# them visible, but not the editable install of this folder.
test-examples: .venv/for-test test-packages
	rm -rf build .venv/wheel
	$(BIN)/pip wheel -qq --disable-pip-version-check --no-deps -w build/wheel .
	$(PYTHON) -m venv --without-pip .venv/wheel
	$(BIN)/pip --python .venv/wheel/bin/python install -qq --disable-pip-version-check --no-deps --no-index \
		build/wheel/pneumatic_hil-*.whl
	cd .venv/wheel/lib/python3*/site-packages && $(CURDIR)/$(BIN)/python -c \
		'import sysconfig; print(sysconfig.get_path("purelib"))' >dependencies.pth
	cd tests/examples && $(CURDIR)/.venv/wheel/bin/python -P -c \
		'import hil; assert "/.venv/wheel/" in hil.__file__, hil.__file__'
	cd tests/examples && $(CURDIR)/.venv/wheel/bin/python -P -m pytest -q

# N calls of the gateway, drawn from SEED on. SEQUENCE=file runs one sequence again.
fuzz: .venv/for-test
	PYTHONPATH=tests $(BIN)/python -m fuzz $(if $(SEQUENCE),--sequence $(SEQUENCE)) \
		--inputs $(or $(N),10000000) --seed $(or $(SEED),1)

# Every mutant of the safety path, or those of MODULES="gateway envelope" alone.
mutants: .venv/for-test
	PYTHONPATH=tests $(BIN)/python -m mutants $(if $(MODULES),--only $(MODULES))

# Each prints its figures beside a peer's, measured in the same run.
bench: .venv/for-test
	missed=0; for script in tests/benchmarks/*.py; do \
		echo "== $$script"; $(BIN)/python $$script || missed=1; \
	done; exit $$missed

# An hour in simulated time and ten minutes on vcan0. SOAK holds other options, such as --real-time-s 20.
soak: .venv/for-test test-packages
	$(BIN)/python tests/soak/soak.py $(SOAK)

lock: .venv/for-test
	$(BIN)/pip install --quiet pip-tools
	$(BIN)/pip-compile --quiet --extra test --extra dev --strip-extras --no-emit-index-url --no-emit-find-links \
		--no-emit-trusted-host --no-annotate --no-header -o requirements.lock pyproject.toml

clean:
	rm -rf .venv build tests/node/node_modules *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find hil firmware_sim design tests -name __pycache__ -prune -exec rm -rf {} +
	rm -f firmware_sim/arm/*.so hil/host/vcan/*.so

.venv/for-run: $(SOURCES_OF_INSTALL) | run-packages
	$(PYTHON) -m venv .venv
	$(BIN)/pip install -qq --disable-pip-version-check -c requirements.lock -e '.[test]'
	touch $@

.venv/for-test: $(SOURCES_OF_INSTALL) | run-packages
	$(PYTHON) -m venv .venv
	$(BIN)/pip install -qq --disable-pip-version-check -c requirements.lock -e '.[test,dev]'
	touch $@ .venv/for-run

# Foxglove's readers of recordings, in the versions of the lock file.
tests/node/node_modules: tests/node/package.json tests/node/package-lock.json | test-packages
	cd tests/node && npm ci --ignore-scripts --no-audit --no-fund --loglevel=error >/dev/null
	touch $@

# Install the Debian packages of programs that are missing.
run-packages:
	$(MISSING); \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || need python3-venv; \
	echo '#include <math.h>' | gcc -E - >/dev/null 2>&1 || need gcc libc6-dev; \
	$(INSTALL)

test-packages:
	$(MISSING); PATH=$$PATH:/usr/sbin:/sbin; \
	command -v linux.uml >/dev/null || need user-mode-linux; \
	command -v modprobe >/dev/null || need kmod; \
	command -v ip >/dev/null || need iproute2; \
	command -v candump >/dev/null || need can-utils; \
	command -v chromium >/dev/null || need chromium; \
	command -v node >/dev/null || need nodejs; \
	command -v npm >/dev/null || need npm; \
	$(INSTALL)

MISSING := missing=; need() { missing="$$missing $$*"; }
INSTALL := [ -z "$$missing" ] || { echo "installing$$missing" && $(SUDO) apt-get update -qq && $(SUDO) env \
	DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $$missing >/dev/null; }
