"""Scores: a file each; every list of scores, in files, tables, tests, pages and exports, is the registry."""
