"""Shared by all packages: grid and frame types, scans, geometry, ray casting, configuration, files, errors."""
