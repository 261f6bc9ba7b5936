# neo_ros from a clone: `make demo` shows it, `make test` checks it. Everything lives in .venv.
SHELL := /bin/bash -o pipefail
VENV := .venv
BIN := $(VENV)/bin
# An interpreter of Python 3.12; empty: search for one.
PYTHON ?=

# The environment is complete in itself: a sourced ROS 2, or the libraries that another
# environment with ROS wheels put into LD_LIBRARY_PATH, would be mixed with its own.
unexport AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONHOME \
	PYTHONPATH RMW_IMPLEMENTATION ROS_DISTRO VIRTUAL_ENV _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Modules that were compiled once are kept: tests start some hundred interpreters.
unexport PYTHONDONTWRITEBYTECODE
# Three files at a time, for many wait for a clock; the slow ones first, see test/conftest.py.
# Threads that wait leave the cores to the other two.
PYTEST := OMP_WAIT_POLICY=PASSIVE $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder

.PHONY: help setup train-setup dev-setup demo check test bench soak fuzz style lint docs constraints clean
help:
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 22

setup: $(VENV)/robot.stamp  ## what a robot needs, in .venv: the node, the bags, no torch
train-setup: $(VENV)/train.stamp  ## and what `neo train` needs (torch: 5 GB)
dev-setup: $(VENV)/dev.stamp  ## and the tools of `make test` and `make lint`

demo: setup  ## a robot's camera widened live, with scores and pictures
	$(BIN)/neo demo

test: dev-setup  ## all tests
	$(PYTEST)

check: dev-setup  ## what one runs before a commit: style, types, and the quick tests
	@$(BIN)/mypy & mypy=$$!; $(BIN)/flake8 && \
	$(PYTEST) -q -m 'not slow and not ros' && wait $$mypy

bench: train-setup  ## speed of every part on this machine, into results/bench.json
	$(BIN)/neo bench

soak: setup  ## an hour of the node at 30 Hz: does it grow or fall behind?
	$(BIN)/neo soak --out results/soak.json

fuzz: dev-setup  ## 100,000 broken messages for the message layer, 5,000 for a live node
	$(BIN)/python test/helpers/message_fuzzer.py

style: dev-setup  ## style alone
	$(BIN)/flake8

lint: style  ## style and types
	$(BIN)/mypy

docs: dev-setup  ## the generated tables of docs/, from results/ and the code
	$(BIN)/python -m neo_ros.documents

constraints:  ## newest versions of all packages into constraints.txt (takes minutes)
	rm -rf $(VENV)-newest
	$(MAKE) VENV=$(VENV)-newest PIP_VERSIONS= dev-setup
	$(VENV)-newest/bin/python -c "$$FREEZE" > $(VENV)-newest/constraints.txt
	mv $(VENV)-newest/constraints.txt constraints.txt
	rm -rf $(VENV)-newest

clean:  ## remove .venv and all that was built; scenes and models in out/ stay
	rm -rf $(VENV) $(VENV)-newest build install log *.egg-info .hypothesis .mypy_cache \
		.pytest_cache
	find neo_ros test launch -name __pycache__ -prune -exec rm -r {} +

PIP_VERSIONS := --constraint constraints.txt
# Of all that pip says, the large downloads: what one waits for.
define pip_install
	@echo 'Installing $(WANTED) into $(VENV)'
	@$(BIN)/python -m pip install --disable-pip-version-check --progress-bar off \
		$(PIP_VERSIONS) --editable '$(WANTED)' | sed -un \
		-e 's/^ *\(Downloading [^ ]* ([0-9.]* [MG]B)\).*/  \1/p' \
		-e 's/^Installing collected packages.*/  Unpacking/p'
	@touch $@
endef

$(VENV)/robot.stamp: WANTED := .[viewer]
$(VENV)/train.stamp: WANTED := .[viewer,video,foxglove,heic,record3d,mesh,train]
$(VENV)/dev.stamp: WANTED := .[viewer,video,foxglove,heic,record3d,mesh,cluster,train,dev]
$(VENV)/robot.stamp: setup.py pyproject.toml constraints.txt | $(VENV)/pyvenv.cfg
	$(pip_install)
$(VENV)/train.stamp: $(VENV)/robot.stamp
	$(pip_install)
$(VENV)/dev.stamp: $(VENV)/train.stamp
	$(pip_install)

# A candidate has to run: the shim that pyenv puts on PATH exists even where it only fails.
define CREATE_VENV
fits='import ensurepip, sys, venv; sys.exit(sys.version_info[:2] != (3, 12))'
shopt -s nullglob
candidates=(python3.12 "$${PYENV_ROOT:-$$HOME/.pyenv}"/versions/3.12*/bin/python3.12
	/usr/bin/python3.12 /usr/local/bin/python3.12)
if [ -n "$$PYTHON" ]; then candidates=("$$PYTHON"); fi
for python in "$${candidates[@]}"; do
	if "$$python" -c "$$fits" 2>/dev/null; then
		echo "Creating $(VENV) with $$python"
		exec "$$python" -m venv "$(VENV)"
	fi
done
echo "make: found no CPython 3.12 with its venv module, tried: $${candidates[*]};" \
	"ROS 2 Jazzy is built for this version. Install it (Ubuntu 24.04: apt install" \
	"python3.12-venv; pyenv install 3.12) or name it: make PYTHON=/path/to/python3.12 ..." >&2
exit 1
endef
define FREEZE
from importlib.metadata import distributions
print('# Versions of all packages that make setup, train-setup and dev-setup install.')
print('# Written by make constraints from a fresh environment with the newest of everything.')
# The ROS wheels contain packages under names that PyPI does not know; pip installed the rest.
for name, version in sorted({
        (found.name.lower(), found.version) for found in distributions()
        if (found.read_text('INSTALLER') or '').strip() == 'pip'
        and found.name not in ('neo_ros', 'neo-ros')}):
    print(f'{name}=={version}')
endef
export CREATE_VENV FREEZE PYTHON

# The pip that comes with Python 3.12 gives up where a download of torch's 2 GB breaks off; the
# constraints' one goes on from there.
$(VENV)/pyvenv.cfg:
	@bash -c "$$CREATE_VENV"
	@$(BIN)/python -m pip install --disable-pip-version-check --quiet $(PIP_VERSIONS) --upgrade pip
