# `make demo` and `make test` need nothing but Rust on a Debian machine: `setup` installs the rest.

CARGO ?= cargo
# The map that the demo left behind, if there is one.
DATA_DIR ?= $(if $(wildcard demo-data),demo-data,waypost-data)
TARGET := $(or $(CARGO_TARGET_DIR),target)/release

.PHONY: demo test serve build setup check bench

# Drive a real recorded sequence through a real server, and compare the loop closures with the truth.
demo: build
	$(TARGET)/waypost demo

# All unit, property and end-to-end tests.
test: setup
	$(CARGO) test --release --locked --workspace

# Keep a server running: robots on port 7600, people on http://127.0.0.1:7601/v1/maps.
serve: build
	$(TARGET)/waypost-server --data-dir $(DATA_DIR)

build: setup
	$(CARGO) build --release --locked --workspace --bins

setup:
	scripts/setup

# What must be clean before a change lands, besides the tests.
check: setup
	$(CARGO) fmt --all -- --check
	$(CARGO) clippy --release --locked --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" $(CARGO) doc --release --locked --workspace --no-deps

bench: setup
	$(CARGO) bench --locked --workspace
