"""Codes of JSON-RPC errors: those of its specification, the daemon's own, and those of programs in front of it."""

from __future__ import annotations

PARSE_ERROR = -32700
INVALID_REQUEST = -32600
METHOD_NOT_FOUND = -32601
INVALID_PARAMS = -32602
INTERNAL_ERROR = -32603

NO_DAEMON = -32000
"""Made by a client: there is no connection, or no answer comes."""
TARGET_ERROR = -32001
REFUSED = -32002
LINK_ERROR = -32003
NOT_AUTHENTICATED = -32004
LIMIT_EXCEEDED = -32005

AWAY = -32010
"""By `skygcs web`: it has no daemon at present."""
NOT_PERMITTED = -32011
"""By `skygcs web`: the page's role may not."""
TOO_LATE = -32012
"""By `skygcs web`: an order without a deadline, or after it."""
