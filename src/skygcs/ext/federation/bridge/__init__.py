"""The bridge between a station's daemon and the hub that joins many stations, a process of its own.

It is a client of the daemon's JSON-RPC and of a nats-server, and no part of the daemon, which never imports it.
"""
