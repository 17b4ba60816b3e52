"""The pages that are made from the sources: `python -m reference` in docs/, or `scripts/build-docs`."""
