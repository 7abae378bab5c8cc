"""Suites: fixed recordings and settings, published rows, and their leaderboard."""
