"""[formation] of the fleet file: live formations about a leader, kept apart by a separation filter."""
