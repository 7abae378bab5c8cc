"""The referee: delivers frames, pairs forecasts with the frames that follow, and finds the strata of cells."""
