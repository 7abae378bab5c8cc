"""The model-free pipeline: clusters, association, state estimation."""
