"""Trackers and trainings in processes of their own, through one supervisor: limits, wire, sandbox, contract checks."""
