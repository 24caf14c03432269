"""The process that reads a motion capture system: connecting to one blocks, and so does waiting for its frames.

source.py   where frames come from: the package `motioncapture`, or a recording
worker.py   the process: frames of the named bodies as lines on its standard output
"""
