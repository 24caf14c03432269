"""Changes of parameters that were left in a vehicle: undone on request."""
