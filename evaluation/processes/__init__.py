"""Tracker processes: limits, outcomes, and the contract suite."""
