"""[mocap]: poses of a motion capture system for vehicles without GPS.

extension.py        the table, state group, clocks and end of it in the daemon
config.py           [mocap] of the fleet file
feed.py             which pose goes to which vehicle, on which link
origin_pushes.py    [origin] for vehicles whose estimators have none
capture_process.py  the process that reads the system, watched
worker.py           that process: frames as lines on its standard output
source.py           where its frames come from: the package `motioncapture`, or a recording
simulated_capture.py, cameras.py   cameras on simulated vehicles
methods.py, commands.py            mocap.status; skygcs-cli mocap

Pure: pose.py (frames of reference), recording.py (poses as lines of JSON), pose_filter.py (which poses may be sent),
lost_body.py (where a lost one can be), pose_way.py (the link of a vehicle's poses), pose_statistics.py (rate, latency,
drop-outs), pose_stream.py (the poses of one vehicle), pose_messages.py
(VISION_POSITION_ESTIMATE and ODOMETRY, and the rate that fits a link).
"""
