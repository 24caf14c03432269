"""Flying with a joystick: the device's events, sticks to velocities, and when anything is sent at all.

`commands`        skygcs-cli joystick: the device, signals, calls to the daemon; the others are pure
`device_events`   struct js_event of the Linux joystick device
`stick_mapping`   axes to a velocity and a yaw rate: dead zone, expo, limits
`stick_session`   the state machine around the dead-man button
"""
