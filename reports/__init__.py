"""Scores and kept samples to HTML."""
