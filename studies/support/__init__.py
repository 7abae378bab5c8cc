"""Parts that several studies and benchmarks use."""
