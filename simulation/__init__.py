"""Simulated recordings with ground truth: a laser model, tracks of road users, the junction and its traffic."""
