"""The runner, the referee, metrics and scores."""
