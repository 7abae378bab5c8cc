"""Recurrent networks as trackers, and the training that all networks of grids share."""
