"""Certificates of separation, and the search for plans that get one. Pure.

What imports numpy is imported by the process of plans and by commands: no daemon loads it.
"""
