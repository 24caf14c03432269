"""Decisions about the flight of a plan: its steps, its checks, and what is ordered as it goes on. Pure."""
