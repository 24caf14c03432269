"""The commands of plans, tables of positions and trajectories."""
