# Every target sets up what it needs: a virtual environment with the versions of constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
READY_DEV := .venv/.ready-dev
READY_DOCS := .venv/.ready-docs
READY_PEERS := .venv/.ready-peers
# Python compiles on first import what is used: a fifth of what would be compiled here.
INSTALL := $(BIN)/python -m pip install -q --disable-pip-version-check --no-compile -c constraints.txt -e
# make test ROOM=drivers: one room alone. make test LONG=1: also further cases of what other tests show.
ROOMS := $(sort $(patsubst tests/%/,%,$(filter-out tests/__%,$(wildcard tests/*/))))

# Whatever the person's shell says: without its cache every process of Python takes three seconds longer to start.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install demo test room lint bench docs faults clean

# The command, with the rod's kernels compiled ahead, 15 s: else the first fit and the first diagnosis wait for them.
install: $(READY)
	$(BIN)/python -m model.warm_up derivatives & beside=$$!; \
	$(BIN)/python -m model.warm_up rods && wait $$beside

demo: $(READY)
	$(BIN)/lab demo --out demo

# One thread of linear algebra a process. What several processes would compile at once is compiled before: the rod, the
# virtual robot and, in a new checkout, the tests; the rod's derivatives are first needed by one process.
test: room $(READY_DEV)
	$(if $(ROOM),,$(BIN)/python -m model.warm_up rods & beside=$$!; $(BIN)/python -c 'from sim_fakes.rig import FakeRig; FakeRig()' && \
	{ $(if $(wildcard tests/__pycache__),,$(BIN)/python -m pytest -n 0 --collect-only > /dev/null;) wait $$beside; })
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(if $(filter 1,$(shell nproc)),2,3) $(if $(LONG),,-m "not long") $(if $(ROOM),tests/$(ROOM))

room:
	@$(if $(filter-out $(ROOMS),$(ROOM)),echo "ROOM=$(ROOM): no such room; one of: $(ROOMS)" >&2; exit 2)

lint: $(READY_DEV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# All benchmarks: tables on the screen, JSON in out/. make bench PEERS=1: with the simulators of others
# beside the rod. make bench QUICK=1: fewer of everything, figures in out/.
QUICKLY := $(if $(QUICK),--quick)
bench: $(READY_DEV) $(if $(PEERS),$(READY_PEERS))
	mkdir -p out
	$(BIN)/python -m benchmarks.rod $(QUICKLY) --json out/rod.json
	$(BIN)/python -m benchmarks.peers $(QUICKLY) --json out/peers.json
	-$(BIN)/python -m benchmarks.recording $(QUICKLY) --json out/recording.json
	$(BIN)/python -m benchmarks.watch $(if $(QUICK),--seconds 10) --json out/watch.json

# The site, read without network: out/docs/index.html.
docs: $(READY_DOCS)
	$(BIN)/sphinx-build -q -W --keep-going -b html -d out/doctrees docs out/docs
	@echo out/docs/index.html

# All tests, the whole fault matrix, then kills, signals, busy starts, fuzz and soak: two hours on two processors.
faults: $(READY_DEV)
	$(MAKE) test LONG=1
	$(BIN)/python -m benchmarks.faults --report out/faults.jsonl
	$(BIN)/python -m benchmarks.faults.stops
	$(BIN)/python -m benchmarks.faults.bad_day
	$(BIN)/python -m benchmarks.faults.kills --count 50
	$(BIN)/python -m benchmarks.faults.kills --count 50 --signal TERM
	$(BIN)/python -m benchmarks.faults.kills --count 50 --signal INT
	$(BIN)/python -m benchmarks.faults.kills --count 10 --signal TERM --protocol bending --loops 20
	$(BIN)/python -m benchmarks.faults.fuzz --recording tests/recordings/data/bending-schema-1.mcap
	$(BIN)/python -m benchmarks.faults.night
	$(BIN)/python -m benchmarks.faults.soak

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(INSTALL) '.[rig]'
	touch $@

$(READY_DEV): $(READY)
	$(INSTALL) '.[dev]'
	touch $@

$(READY_PEERS): $(READY_DEV)
	$(INSTALL) '.[peers]'
	touch $@

$(READY_DOCS): $(READY)
	$(INSTALL) '.[docs]'
	touch $@

clean:
	rm -rf .venv demo out
