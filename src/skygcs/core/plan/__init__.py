"""Plans as data: what one is, the files that one is read from, formations, and the distance that vehicles must keep.

A plan is a trajectory for each vehicle on one common clock, or phases of straight legs with a barrier between them.
What makes, certifies and flies it is an extension; reports, formations and the page's checks read the same plans.
"""
