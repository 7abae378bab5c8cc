"""The referee: what came set against what was forecast, counted."""
