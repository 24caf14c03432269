"""ROS as data: interface definitions and their encodings, and converters from MAVLink messages to ROS messages. Pure.

One table of topics (`topics`) and one set of converters (`telemetry`) serve the live topics of ROS 2 and ROS 1 and the
bags that a log is exported to. Nothing here needs ROS.
"""
