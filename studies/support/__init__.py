"""What several studies and benchmarks use."""
