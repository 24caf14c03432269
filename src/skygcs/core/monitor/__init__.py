"""The watch over the distances between vehicles: which are about to meet, when, and which of them should hold. Pure.

`tracks`           what is known of each vehicle's motion, as the monitor uses it, and which vehicles it cannot watch
`approach`         the closest approach of two vehicles in closed form
`conflict_levels`  notice, warning and action of each pair, and which vehicle of a pair holds
`order_check`      whether an order, or trajectories that are about to begin, would bring a vehicle too close to another
"""
