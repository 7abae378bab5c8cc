"""The particle grid: Dempster-Shafer masses of the cells, and particles that carry the velocities."""
