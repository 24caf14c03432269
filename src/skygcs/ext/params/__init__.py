"""Parameters of vehicles: read, set, listed, and what they mean."""
