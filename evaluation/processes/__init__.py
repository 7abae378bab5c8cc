"""Trackers in processes of their own: limits, outcomes, and the contract suite over them."""
