"""What every `fit` shares: weights and their cards, searches, excerpts, labelled scans, calibration, progress."""
