"""Speed of gridtrack, with peers beside it: `python -m benchmarks.NAME` from the repository root."""
