"""Decisions about the flight of a plan: its steps, what is checked before it, and what is ordered as it goes on. Pure."""
