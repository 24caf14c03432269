"""Missions, fences and rally points of autopilots: plans up and down, and missions in flight."""
