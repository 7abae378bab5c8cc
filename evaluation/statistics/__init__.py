"""From counts to claims: intervals, paired differences, and the summary."""
