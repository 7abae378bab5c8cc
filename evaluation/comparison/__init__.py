"""Planning and running a comparison, and the folder that it leaves."""
