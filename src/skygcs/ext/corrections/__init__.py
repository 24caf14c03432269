"""``[corrections]``: RTK corrections that the daemon gets itself, from a caster or from a base receiver of its own."""
