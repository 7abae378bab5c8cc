"""Small recordings, their licences, and trained weights; inside the wheel, so that an installed gridtrack has its demo."""
