"""Statistics of the counts: intervals, paired differences, and the summary."""
