"""How fast it is, beside something named: `python -m benchmarks [NAME ...] [--write]`, or `make bench`."""
