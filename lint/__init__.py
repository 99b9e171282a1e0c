"""House rules that ruff and import-linter cannot express; run by `make lint`."""
