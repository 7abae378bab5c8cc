"""The referee: forecasts paired with the observed frames, and counts of their scores."""
