"""Small recordings with their licences, and trained weights: inside the wheel, so an installed gridtrack has them."""
