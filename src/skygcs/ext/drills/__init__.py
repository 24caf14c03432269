"""[drills]: faults of vehicles that the daemon itself simulates, for people who practise."""
