# `make demo` and `make test` need nothing but Rust on a Debian machine: `setup` installs the rest.

CARGO ?= cargo
# What cargo is told besides: CI's says how to compile (.ci/cargo.toml).
CARGO_FLAGS ?=
# A demo's map is served with DATA_DIR=demo-data.
DATA_DIR ?= waypost-data
TARGET := $(or $(CARGO_TARGET_DIR),target)/release
# Where the Python client is tested in, with every version pinned.
PYTHON := $(abspath $(or $(CARGO_TARGET_DIR),target)/python)
# Where a real ROS 2 is, which the bridge is tested with.
ROS2 := $(abspath $(or $(CARGO_TARGET_DIR),target)/ros2)
# Where the C++ client is built.
CPP := $(abspath $(or $(CARGO_TARGET_DIR),target)/cpp)

# How many of the tests that are not Rust's run at once, and how many of Rust's: they wait for much, for robots as for browsers,
# so that one more than there are cores keeps these busy.
JOBS ?= 3
TEST_THREADS ?= $(shell expr $$(nproc) + 1)
# What is fuzzed, and for how long: make fuzz FUZZ=model SECONDS=600
FUZZ ?= all
SECONDS ?= 60

.PHONY: demo fuzz test build-tests test-rust test-postgres test-python test-cpp test-ros test-inspector test-image inspector docs serve build setup setup-python setup-tests check deny bench

# Drive a real recorded sequence through a real server, and compare the loop closures with the truth.
demo: build
	$(TARGET)/waypost demo

# All unit, property and end-to-end tests, a part of these on PostgreSQL, and those of the Python client, of docker/, docs/ and
# packaging/, of ros/, of the page and of the C++ client.
# What the others need is fetched while Rust compiles. Rust's tests keep all cores busy, and those of ros/ wait for most of
# their ten minutes: both run at once. Those of ros/ go first where both want to: a robot does not wait for a bridge that is late.
test: setup
	$(MAKE) --no-print-directory --jobs=2 build-tests setup-tests
	$(MAKE) --no-print-directory --jobs=2 --keep-going test-rust test-ros
	$(MAKE) --no-print-directory --jobs=$(JOBS) --output-sync=target --keep-going \
		test-postgres test-python test-inspector test-cpp

build-tests: setup
	$(CARGO) test $(CARGO_FLAGS) --release --locked --workspace --no-run

test-rust: build
	WAYPOST_BINARIES=$(abspath $(TARGET)) RUST_TEST_THREADS=$(TEST_THREADS) nice -n 5 \
		$(CARGO) test $(CARGO_FLAGS) --release --locked --workspace --no-fail-fast

# Servers over a database of PostgreSQL that is made for the tests; and a part of the other end-to-end tests, each on such a
# database. More of them: make test-postgres ON_POSTGRES="fleet:: maps:: merging:: rest::parity operations::tokens"
ON_POSTGRES ?= fleet:: maps::corrections maps::notes maps::snapshots::a_map_comes merging::whole_maps rest::parity operations::tokens
# The same, where all is asked of a server that does not own the database.
IN_RESERVE ?= rest::parity merging::whole_maps::two_maps merging::whole_maps::a_merge_without maps::snapshots::a_map_comes \
	navigation::goals
# The same, with media in a folder.
IN_A_FOLDER ?= robots::frames maps::pictures maps::snapshots::a_map_comes maps::rebind maps::explain merging::whole_maps::two_maps
# What looks into SQLite's file, or has a server of its own there.
OF_SQLITE = maps::restore maps::snapshots::a_stalled maps::snapshots::stalled maps::snapshots::interrupted::an_import_that_fails \
	maps::snapshots::interrupted::an_import_that_is_cancelled_while maps::snapshots::removal merging::compaction::what_was_removed \
	operations::tokens::older robots::frames::kept_features
test-postgres: build
	WAYPOST_BINARIES=$(abspath $(TARGET)) scripts/with-postgres \
		$(CARGO) test $(CARGO_FLAGS) --release --locked --workspace --test end_to_end -- $(ON_POSTGRES) $(foreach test,$(OF_SQLITE),--skip $(test))
	WAYPOST_BINARIES=$(abspath $(TARGET)) WAYPOST_TEST_ASKED_IN_RESERVE=1 scripts/with-postgres \
		$(CARGO) test $(CARGO_FLAGS) --release --locked --workspace --test end_to_end -- $(IN_RESERVE)
	WAYPOST_BINARIES=$(abspath $(TARGET)) WAYPOST_TEST_MEDIA=1 scripts/with-postgres \
		$(CARGO) test $(CARGO_FLAGS) --release --locked --workspace --test end_to_end -- $(IN_A_FOLDER) $(foreach test,$(OF_SQLITE),--skip $(test))

# What the client's messages, arrays and calls go through, with the oldest and the newest packages that it works with.
RANGE_TESTS = test_values.py test_decisions.py test_words.py test_calls.py
test-python: build setup-python
	WAYPOST_BINARIES=$(abspath $(TARGET)) scripts/with-postgres $(PYTHON)/bin/python -m pytest client/python docker docs packaging
	WAYPOST_BINARIES=$(abspath $(TARGET)) WAYPOST_PYTHON=$(PYTHON) scripts/test-python-range $(PYTHON)-range $(RANGE_TESTS)

# The bridge between a server and a robot that another DDS plays. Once in thirteen runs Python itself crashed in the library
# of that DDS: such an end, by a signal, says nothing of the bridge, and the tests run once more. A test that fails has failed.
ROS_TESTS = WAYPOST_ROS2=$(ROS2) WAYPOST_BINARIES=$(abspath $(TARGET)) $(PYTHON)/bin/python -m pytest ros/tests
test-ros: build setup-python
	scripts/setup-ros2 $(ROS2)
	$(ROS_TESTS) || { ended=$$?; [ $$ended -ge 128 ] || exit $$ended; echo "ended by a signal: once more" >&2; $(ROS_TESTS); }

# The page in a real browser, on a real server.
test-inspector: build
	scripts/setup-inspector
	cd inspector && WAYPOST_BINARIES=$(abspath $(TARGET)) npm run --silent test

# The C++ client on real servers. Speed is not what its tests are about: it is compiled in a minute.
test-cpp: build
	scripts/setup-cpp
	cmake -S client/cpp -B $(CPP) -DCMAKE_CXX_FLAGS=-O1 >/dev/null
	cmake --build $(CPP) --parallel 2 -- --no-print-directory --silent
	cd $(CPP) && WAYPOST_BINARIES=$(abspath $(TARGET)) ctest --parallel 2 --output-on-failure

# The container image, built and used, as root on Debian 12.
test-image: build
	scripts/setup image
	scripts/test-image $(TARGET)

# Bytes that nobody means, to everything that strangers send. `make test` does a little of it.
fuzz: setup
	scripts/fuzz $(FUZZ) $(SECONDS)

# Build the page anew into server/inspector, which the server embeds.
inspector:
	scripts/setup-inspector
	cd inspector && npm run --silent types && npm run --silent check && npm run --silent build

# The guide's reference pages, from the sources, and the guide as a book in target/book.
docs: build
	scripts/build-docs $(TARGET)

# Keep a server running: robots on port 7600, people on http://127.0.0.1:7601.
serve: build
	$(TARGET)/waypost-server --data-dir $(DATA_DIR)

build: setup
	$(CARGO) build $(CARGO_FLAGS) --release --locked --workspace --bins
	scripts/split-symbols $(TARGET) waypost-server waypost waypost-ros

setup:
	scripts/setup

# Once for all that use it: it installs the client anew.
setup-python: setup
	scripts/setup-python $(PYTHON)

# What the tests after Rust's need, one after the other: two package managers at once get into each other's way.
setup-tests: setup-python
	scripts/setup-ros2 $(ROS2)
	scripts/setup-inspector
	scripts/setup-cpp

# The client, the command line and the bridge are built without what they can do without, too. The server is not about that: with
# it, most of others' crates keep the features that they were checked with before.
WITHOUT_FEATURES = -p waypost-client -p waypost-cli -p waypost-ros -p waypost-server

# What must be clean before a change lands, besides the tests.
check: setup
	$(CARGO) fmt --all -- --check
	$(CARGO) clippy $(CARGO_FLAGS) --release --locked --workspace --all-targets -- -D warnings
	$(CARGO) clippy $(CARGO_FLAGS) --release --locked $(WITHOUT_FEATURES) --no-default-features -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc $(CARGO_FLAGS) --release --locked --workspace --no-deps
	scripts/check-inspector

# Licences, sources and advisories of what is built in, where cargo-deny is installed.
deny:
	@if $(CARGO) deny --version >/dev/null 2>&1; then $(CARGO) deny check; \
	else echo "cargo-deny is not installed: cargo install --locked cargo-deny" >&2; fi

bench: setup
	$(CARGO) bench $(CARGO_FLAGS) --locked --workspace
