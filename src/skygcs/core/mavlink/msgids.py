"""Message ids that the code compares with (common.xml, ardupilotmega.xml), each defined once.

Code that encodes or decodes a message uses its name and the dialect; these ids are for decisions about frames whose
payload need not be decoded.
"""

from __future__ import annotations

HEARTBEAT = 0
SYSTEM_TIME = 2
PING = 4
SET_MODE = 11
PARAM_REQUEST_READ = 20
PARAM_REQUEST_LIST = 21
PARAM_VALUE = 22
PARAM_SET = 23
GLOBAL_POSITION_INT = 33
MISSION_SET_CURRENT = 41
MISSION_CURRENT = 42
MISSION_ITEM_REACHED = 46
REQUEST_DATA_STREAM = 66
COMMAND_INT = 75
COMMAND_LONG = 76
COMMAND_ACK = 77
POSITION_TARGET_GLOBAL_INT = 87
RADIO_STATUS = 109
FILE_TRANSFER_PROTOCOL = 110
TIMESYNC = 111
LOG_ENTRY = 118
LOG_DATA = 120
RADIO = 166
MAG_CAL_PROGRESS = 191
MAG_CAL_REPORT = 192
GPS_RTCM_DATA = 233
HIGH_LATENCY2 = 235
MESSAGE_INTERVAL = 244
EXTENDED_SYS_STATE = 245
STATUSTEXT = 253
SETUP_SIGNING = 256
"""Carries a key. The signing guide: never broadcast, never forwarded, never logged."""
PARAM_EXT_REQUEST_READ = 320
PARAM_EXT_REQUEST_LIST = 321
PARAM_EXT_SET = 323
EVENT = 410
