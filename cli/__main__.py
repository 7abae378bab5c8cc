"""`python -m gridtrack.cli`."""

from gridtrack.cli import main

main()
