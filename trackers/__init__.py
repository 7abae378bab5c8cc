"""The plugin contract, the registry, and one sub-package for each family of built-in trackers."""
