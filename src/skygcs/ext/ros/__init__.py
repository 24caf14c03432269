"""[ros]: vehicles as topics and services of ROS 2, by a process of its own that is a client of the socket."""
