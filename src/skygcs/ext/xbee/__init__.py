"""Tools for XBee modules: skygcs-cli xbee.

commands.py  show, set, discover
port.py      the module at a serial port
"""
