"""Trackers with a network that reads the last frames and keeps no state."""
