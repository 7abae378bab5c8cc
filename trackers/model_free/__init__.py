"""The model-free pipeline: background, segmentation, association, state estimation, track management, forecast."""
