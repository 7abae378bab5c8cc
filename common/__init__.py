"""What everything shares: grid and frame types, geometry, ray casting, recordings, configuration, errors."""
