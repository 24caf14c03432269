"""Plans for a fleet: files of trajectories, formations, and certificates of separation.

A plan is a trajectory for each vehicle on one common clock, or phases of straight legs with a barrier between them.
What imports numpy is imported by the function that needs it: the daemon reads plans without it.
"""
