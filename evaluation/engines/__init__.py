"""Engines: what carries out the work of a run, on one machine or on many."""
