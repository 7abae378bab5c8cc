"""The regression gate: the counts of a run as a baseline, and the verdict on a later run."""
