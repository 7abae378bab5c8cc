"""Coordinate frames of a recording: the tree of its transforms, and the chain from a world frame to each sensor."""
