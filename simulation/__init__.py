"""Scenes made up and measured: a laser in them, road users' tracks, and the junction they meet at."""
