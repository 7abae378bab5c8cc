"""The formats that recordings are read from, one module each; found by the entry point group `gridtrack.recordings`."""
