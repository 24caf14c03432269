"""Poses of a motion capture system on their way to autopilots. Pure.

pose.py             a pose and the frames it is given in
recording.py        poses as lines of JSON: what the capture process writes, and a recording
pose_filter.py      which poses may be sent
pose_statistics.py  rate, latency and drop-outs of one body
pose_stream.py      the poses of one vehicle: filter, statistics, rate
pose_messages.py    VISION_POSITION_ESTIMATE and ODOMETRY, and the rate that fits a link
"""
