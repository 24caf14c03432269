"""The watch over the distances between vehicles: which are about to meet, when, and which of them should hold. Pure.

`tracks`            what is known of each vehicle's motion, as the monitor uses it, and which vehicles it cannot watch
`approach`          the closest approach of two vehicles in closed form
`conflict_levels`   notice, warning and action of each pair, with confirmation and hysteresis
`yielding`          which vehicle of a pair holds, and whether that helps
`order_check`       whether an order would bring a vehicle too close to another
`trajectory_check`  whether trajectories that are about to begin would
"""
