"""Engines: where the jobs of a run are executed, on one machine or on many."""
