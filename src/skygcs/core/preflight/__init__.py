"""Judge whether a vehicle is ready to fly: a table of checks, each a verdict with the figure, the limit and what to do.
Pure.

`report`        everything the checks look at, as plain values; findings and what they add up to
`health`        checks of what the vehicle reports of itself and of its link, and of its external poses
`settings`      checks of its parameters
`table`         all of them in order, what they need, and `examine`
"""
