# energyopt: `make demo` plans and proves a motion, `make test` runs the tests; both set themselves up.
# Needs make and Python ≥ 3.11; after the first run nothing is downloaded again.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: demo test lint bench notebooks dist lock clean distclean help
MAKEFLAGS += --no-print-directory

VENV ?= .venv
OUT ?= out
# Pinocchio, CasADi and MuJoCo come as wheels: no compiler, display or GPU is needed.
export MPLBACKEND := Agg
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYTHONNOUSERSITE := 1
unexport PYTHONPATH PYTHONHOME

PY := $(VENV)/bin/python
PIP := $(PY) -m pip --quiet
RUN_STAMP := $(VENV)/.installed
DEV_STAMP := $(VENV)/.installed-dev

help:  ## list these targets
	@sed -n 's/^\([a-z]*\):.*##/\1\t/p' Makefile | while IFS="$$(printf '\t')" read -r name text; do printf '  make %-11s %s\n' "$$name" "$$text"; done

demo: $(RUN_STAMP)  ## plan a Panda motion, replay it in MuJoCo, print the numbers, write the files
	@$(PY) -m energyopt plan problems/panda_reach.toml --out $(OUT)/panda_reach

test: $(DEV_STAMP)  ## run the tests, a worker a core (PYTEST_ARGS="-k name" to choose, "-n0 --pdb" to look inside)
	@$(PY) -m pytest -n auto --dist worksteal $(PYTEST_ARGS)

lint: $(DEV_STAMP)  ## check the code with ruff
	@$(PY) -m ruff check .

bench: $(RUN_STAMP)  ## run the benchmark suites (SUITE=name for one)
	@$(PY) -m energyopt bench $(SUITE)

notebooks: $(DEV_STAMP)  ## run every notebook in place
	@for n in notebooks/*.ipynb; do echo "Running $$n"; $(PY) -c 'from nbclient.cli import main; main()' --inplace "$$n" || exit 1; done

dist: $(DEV_STAMP)  ## build wheel and sdist into dist/
	@$(PY) -m build --no-isolation --outdir dist .

lock:  ## renew the lock files (needs uv)
	uv pip compile --quiet --universal --generate-hashes --no-annotate --fork-strategy fewest --custom-compile-command "make lock" \
	  --output-file requirements.lock pyproject.toml requirements-build.in
	uv pip compile --quiet --universal --generate-hashes --no-annotate --fork-strategy fewest --custom-compile-command "make lock" \
	  --extra dev --constraint requirements.lock --output-file requirements-dev.lock pyproject.toml

clean:  ## remove what was built or measured; the environment stays
	rm -rf $(OUT) build dist .pytest_cache .ruff_cache *.egg-info
	find energyopt tests problems -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean  ## remove the environment too
	rm -rf $(VENV)

# Stamp files: they are newer than what they were made from only when the installation was complete.
$(RUN_STAMP): requirements.lock pyproject.toml | $(PY)
	@echo "Installing energyopt and what it needs (requirements.lock, exact versions) into $(VENV) ..."
	@$(PIP) install --require-hashes --requirement requirements.lock
	@$(PIP) install --no-index --no-deps --no-build-isolation --editable .
	@touch $@

$(DEV_STAMP): requirements-dev.lock $(RUN_STAMP)
	@echo "Installing the test tools (requirements-dev.lock, exact versions) into $(VENV) ..."
	@$(PIP) install --require-hashes --requirement requirements-dev.lock
	@touch $@

$(PY):
	@set -e; for p in $(PYTHON) python3 python3.13 python3.12 python3.11; do \
	  if "$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then found="$$p"; break; fi; done; \
	if [ -z "$$found" ]; then echo "energyopt needs Python 3.11 or newer; none found (name one with: make PYTHON=/path/to/python)" >&2; exit 1; fi; \
	echo "Making a Python environment in $(VENV) with $$("$$found" --version) ..."; \
	"$$found" -m venv $(VENV) || { rm -rf $(VENV); echo "no environment could be made: Debian and Ubuntu need the package python3-venv" >&2; exit 1; }
