"""What other sites send, of whatever kind."""

from __future__ import annotations

import json
from typing import Any

from skygcs.core.federation.remote_sites import RemoteSites
from skygcs.federation.bus import Message
from skygcs.federation.readers import Readers
from skygcs.federation.site_clock import SiteClock

EVENT = {"time_unix_s": 1.5, "kind": "mode", "vehicle": "alpha", "sysid": 1, "text": "hold", "data": {}}


def sent(seq: Any, **changes: Any) -> Message:
    event = {"v": 1, "site": "south", "run": "r", "seq": seq, "event": {**EVENT, **changes}}
    return Message("event.south", json.dumps(event).encode())


def test_an_event_that_no_client_could_show_is_left_out() -> None:
    bus: Any = None
    readers = Readers(bus, RemoteSites("north", "mine"), SiteClock(), own_site="north")
    read = readers._on_event
    read(sent(1))
    for seq in (10**400, -1, "2"):  # a number of thousands of digits could not be counted, nor be read by a client
        read(sent(seq))
    for wrong in ({"time_unix_s": 10**400}, {"time_unix_s": "now"}, {"kind": []}, {"vehicle": {}}, {"text": None}):
        read(sent(2, **wrong))
    assert len(readers.recent) == 1
    assert readers.counters["events_bad"] == 8 and readers.counters["events_lost"] == 0
    read(sent(4))
    assert readers.counters["events_lost"] == 2


def test_texts_and_numbers_of_an_event_can_be_shown() -> None:
    bus: Any = None
    readers = Readers(bus, RemoteSites("north", "mine"), SiteClock(), own_site="north")
    bad = {"text": "\x1b]0;mine\x07" + 5000 * "x", "kind": "mode\n", "vehicle": "\u202ealpha"}
    message = sent(1, **bad, data={"\x9b2J": "a\nb", "n": 10**400, "far": "FAR"})
    readers._on_event(Message(message.subject, message.data.replace(b'"FAR"', b"1e999")))
    (event,) = readers.recent
    assert event["data"] == {"?2J": "a?b", "n": None, "far": None}
    assert len(event["text"]) == 1000 and all(event[key].isprintable() for key in bad)
