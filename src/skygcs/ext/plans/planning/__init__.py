"""Plans are searched and certified in a process of their own, for the command line and for the daemon alike.

request.py         what the process is asked, as JSON
worker.py          the process: numpy is loaded there and nowhere else
process.py         starts it, bounds its time and memory, passes on its progress, ends it
planning_queue.py  the requests of the daemon's clients, in turn
"""
