"""Preflight of vehicles, on request."""
