"""``[corrections]``: RTK corrections that the daemon fetches itself, from a caster or from a base receiver of its own."""
