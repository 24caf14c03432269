"""Timed trajectories of single vehicles, as the methods of clients."""
