"""Planning and running a comparison, and the folder of its results."""
