"""Recorded outputs of a stack as forecasts: grids, or objects drawn as grids."""
