"""gridtrack: occupancy-grid trackers side by side, on one stream, under one referee."""
