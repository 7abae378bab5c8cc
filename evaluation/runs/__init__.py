"""A run: its plan, trials and stages, its folder and files, resuming, and live recordings."""
