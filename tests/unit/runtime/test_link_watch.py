"""How well vehicles are heard: losses of the last half minute, signal of radios."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mavlink.msgids import RADIO_STATUS
from skygcs.core.routing.source_statistics import SourceStats
from skygcs.runtime.link_view import LinkWatch
from support.table import each
from support.vehicles import flight_dialect

KEY = 1 << 8 | 1


class FakeHub:
    """One channel of one link, on which one vehicle is heard."""

    def __init__(self, kind: str = "serial") -> None:
        self.stats = SourceStats(1, 1)
        self.channel: Any = SimpleNamespace(
            id=7,
            sources={KEY: self.stats},
            link=SimpleNamespace(name="radio"),
            config=SimpleNamespace(type=kind),
            air=None,
        )
        self.channels = {7: self.channel}
        self.router = SimpleNamespace(channels_of=lambda key: [n for n in self.channels if key == KEY])


def radio_status(**fields: int) -> Frame:
    info = flight_dialect().by_name["RADIO_STATUS"]
    return Frame(encode(info, fields, sysid=51, compid=68, seq=0), 0, 51, 68, RADIO_STATUS, info)


def watch(hub: FakeHub) -> LinkWatch:
    hub_: Any = hub
    return LinkWatch(hub_)


def test_only_what_was_lost_lately_counts() -> None:
    hub = FakeHub()
    watching = watch(hub)
    hub.stats.frames, hub.stats.lost = 5000, 5000
    watching.tick(0.0)
    assert watching.of(KEY, 0.0)["radio"].loss is None
    hub.stats.frames, hub.stats.lost = 5080, 5020
    watching.tick(1.0)
    assert watching.of(KEY, 1.0)["radio"].loss == pytest.approx(0.2)
    assert watching.of(2 << 8 | 1, 1.0) == {}


def test_the_worse_end_of_a_radio_counts_while_it_is_fresh() -> None:
    hub = FakeHub()
    watching = watch(hub)
    watching.on_radio(radio_status(rssi=120, noise=40, remrssi=78, remnoise=40), hub.channel, 10.0)
    assert watching.of(KEY, 12.0)["radio"].margin_db == pytest.approx(20.0)
    assert watching.of(KEY, 30.0)["radio"].margin_db is None


@each("fields", [{}, {"rssi": 255, "noise": 255, "remrssi": 255, "remnoise": 255}])
def test_a_radio_that_says_nothing(fields: dict[str, int]) -> None:
    hub = FakeHub()
    watching = watch(hub)
    watching.on_radio(radio_status(**fields), hub.channel, 10.0)
    assert watching.of(KEY, 10.0)["radio"].margin_db is None


def test_a_recorded_radio_tells_of_another_day() -> None:
    hub = FakeHub("replay")
    watching = watch(hub)
    watching.on_radio(radio_status(rssi=120, noise=40), hub.channel, 10.0)
    assert watching.of(KEY, 10.0)["radio"].margin_db is None


def test_what_is_gone_is_forgotten() -> None:
    hub = FakeHub()
    watching = watch(hub)
    watching.tick(0.0)
    watching.on_radio(radio_status(rssi=120, noise=40), hub.channel, 0.0)
    del hub.channels[7]
    watching.tick(1.0)
    hub.channels[7] = hub.channel
    assert watching.of(KEY, 1.0)["radio"].margin_db is None and watching.of(KEY, 1.0)["radio"].frames == 0
