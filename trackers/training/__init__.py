"""Shared by every `fit`: weights and their cards, searches, excerpts, labelled scans, calibration, progress."""
