"""Structured fuzzing of every reader: small valid inputs, damage behind valid checksums, and one rule for all."""
