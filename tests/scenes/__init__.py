"""Scenes that tests are made from: a hall, a street, a run with scores of one's choice, and one with truth."""
