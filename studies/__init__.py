"""Studies: each module answers one question. `python -m studies.NAME` from the repository root."""
