# Every target sets up what it needs: a virtual environment with the versions of constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

.PHONY: demo test lint bench faults clean

demo: $(READY)
	$(BIN)/lab demo --out demo

# One thread of linear algebra a process: they share the processors with the fakes.
test: $(READY)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 3

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# All benchmarks: tables on the screen, JSON in out/.
bench: $(READY)
	mkdir -p out
	$(BIN)/python -m benchmarks.rod --json out/rod.json
	$(BIN)/python -m benchmarks.recording --json out/recording.json

# The whole fault matrix, then kills, signals, fuzz and soak: an hour and a half on two processors.
faults: $(READY)
	$(BIN)/python -m benchmarks.faults --report out/faults.jsonl
	$(BIN)/python -m benchmarks.faults.kills --count 50
	$(BIN)/python -m benchmarks.faults.kills --count 50 --signal TERM
	$(BIN)/python -m benchmarks.faults.kills --count 50 --signal INT
	$(BIN)/python -m benchmarks.faults.fuzz --recording tests/recordings/data/bending-schema-1.mcap
	$(BIN)/python -m benchmarks.faults.soak

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $(READY)

clean:
	rm -rf .venv demo out
