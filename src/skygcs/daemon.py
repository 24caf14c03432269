"""Composition root: config -> objects -> task groups; ordered shutdown."""
