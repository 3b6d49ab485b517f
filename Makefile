# make demo    the whole story, small           make demo ARGS="--seed 1" passes options on
# make test    ruff, types, short tests         make test ARGS="-k layers" passes options on to pytest
# make test-all   the long tests                ARGS as above; the two together are all there is
# make docs    the site, in build/site/index.html; ARGS=--no-outputs leaves the tutorials unrun
# make lock    requirements.lock from pyproject.toml (needs uv); ARGS=--upgrade renews every pin
# make clean   removes what the others made, but not runs/
# Needs Python 3.11, 3.12 or 3.13 and nothing else: python3 if it is one of these, or else python3.13, python3.12 or
# python3.11; another one: make PYTHON=/path/to/python ...

FITS := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
PYTHON ?= $(shell for name in python3 python3.13 python3.12 python3.11; do \
	$$name -c '$(FITS)' 2>/dev/null && { echo $$name; exit; }; done; echo python3)
UV ?= uv
ARGS ?=
BIN := .venv/bin

# Files run in parallel.
PYTEST := $(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder

.PHONY: demo test test-all docs lock clean
.DELETE_ON_ERROR:

test test-all demo: export OMP_NUM_THREADS = 1
test test-all demo: export OPENBLAS_NUM_THREADS = 1

demo: .venv/.installed
	$(BIN)/motorprior demo --out runs/demo $(ARGS)

test: .venv/.installed
	$(BIN)/ruff check
	$(BIN)/basedpyright
	@$(PYTEST) -m "not slow and not real_time" $(ARGS); first=$$?; \
	case $$first in 0|1|5) ;; *) exit $$first ;; esac; \
	echo "Tests against robots that live in real time, alone:"; \
	$(BIN)/pytest -rs -m "not slow and real_time" $(ARGS); second=$$?; \
	case $$first$$second$(if $(ARGS),+) in 00|00+|05+|50+) ;; *) exit 1 ;; esac  # 5: ARGS ask for none of these

test-all: .venv/.installed
	$(PYTEST) -m slow $(ARGS)

docs: export OMP_NUM_THREADS = 1
docs: .venv/.installed
	$(BIN)/python website/assemble.py build/pages $(ARGS)
	$(BIN)/zensical build --strict

# The stamp goes first and comes back last: after an interrupted install the next run starts from nothing.
.venv/.installed: requirements.lock pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo "No $(PYTHON) here: install Python 3.11, 3.12 or 3.13." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; (3, 11) <= sys.version_info[:2] <= (3, 13) or sys.exit("motorprior needs Python 3.11, 3.12 or 3.13, but $(PYTHON) is " + sys.version.split()[0] + ": try make PYTHON=python3.11")'
	@if [ ! -e $@ ]; then rm -rf .venv && echo "Setting up .venv (a few minutes, once)" && $(PYTHON) -m venv .venv; fi
	@rm -f $@
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

lock:
	@command -v $(UV) >/dev/null || { echo "make lock needs uv: pip install uv" >&2; exit 1; }
	$(UV) pip compile --quiet --universal --python-version 3.11 --fork-strategy fewest --extra dev --generate-hashes \
		--no-emit-index-url --no-emit-find-links --custom-compile-command "make lock" \
		$(ARGS) --output-file requirements.lock pyproject.toml

clean:
	rm -rf .venv build dist .pytest_cache .ruff_cache .hypothesis
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
