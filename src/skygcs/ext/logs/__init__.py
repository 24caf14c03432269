"""Recorded flights: without a daemon skygcs-cli tlog, plot, report and foxglove; [recordings] in the daemon.

Readers, pure: census (what is in a recording), flight and curves (what is drawn of a vehicle), tables (what is a row of
a file), motion and path (poses for viewers), foxglove_schemas, trace_figures (how well a vehicle tracked),
recorded_node (the topics of ROS).
Writers: cutting, table_files, flight_plot, trace_plot, mcap_file, rosbag_file; player sends a recording on.
Daemon: recordings lists and replays those of its folder, methods are its RPC methods.
Commands: commands (tlog), plot, foxglove. report: a package of its own, a whole day as one page.
"""
