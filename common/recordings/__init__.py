"""Recordings of laser scans: the native MCAP form, imports from other formats, resampling to a fixed period."""
