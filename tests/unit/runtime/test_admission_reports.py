"""What is told of others' traffic, to whom, and in whose name."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from skygcs.config.models import DaemonConfig
from skygcs.core.mavlink.frame import encode
from skygcs.core.radio_link.admission import ThirdPartyRules
from skygcs.core.radio_link.capacity import RadioRates
from skygcs.core.radio_link.transmit_queue import OwnMessage, Priority, TxQueue
from skygcs.events import Event
from skygcs.links.paced import AirBudget
from skygcs.runtime.admission_reports import TEXT_BYTES, AdmissionReports
from skygcs.runtime.hub import Hub
from support.routed import DIALECT
from support.table import each

QGC = 255 << 8 | 190


class Watched:
    """A radio, a station and a program that is bound to a vehicle, which have the same source id."""

    def __init__(self, *, air_kbps: float | None = 64.0, heartbeat: bool = True, **rules: Any) -> None:
        self.air = AirBudget(TxQueue(), RadioRates(57600, air_kbps, 11), 0.0, ThirdPartyRules(**rules), DIALECT)
        self.events: list[Event] = []
        self.sent: dict[str, list[OwnMessage]] = {"station": [], "bound": [], "radio": []}
        channels = {
            1: self._channel("radio", "radio", air=self.air),
            2: self._channel("station", "gcs"),
            3: self._channel("bound", "gcs", translator=object()),
        }
        router = SimpleNamespace(channels_of=lambda source: (1, 2, 3, 99) if source == QGC else ())
        hub = cast(Hub, SimpleNamespace(channels=channels, router=router))
        self.watch = AdmissionReports(hub, DaemonConfig(heartbeat=heartbeat), DIALECT, self.events.append)
        self.watch.tick(0.0)

    def _channel(self, name: str, role: str, air: AirBudget | None = None, translator: object = None) -> Any:
        return SimpleNamespace(
            air=air,
            translator=translator,
            peer=name,
            config=SimpleNamespace(role=role, type="udp_server"),
            link=SimpleNamespace(name=name),
            send=lambda message, priority: self.sent[name].append(message),
        )

    def offer(self, name: str, times: int = 1, **values: Any) -> None:
        for number in range(times):
            raw = encode(DIALECT.by_name[name], values, sysid=255, compid=190, seq=0)
            self.air.offer(raw, Priority.FORWARDED, number / 10)
        self.watch.tick(times / 10)


@each(
    ("rules", "name", "values", "sentence", "text"),
    [
        ({}, "REQUEST_DATA_STREAM", {"target_system": 3}, "asks vehicle 3 for streams", "streams are planned here"),
        ({}, "LOG_REQUEST_LIST", {"target_system": 3}, "10 MB take 5.0 h", "no log downloads"),
        ({}, "PARAM_REQUEST_LIST", {}, "asks all vehicles for all parameters", "parameter list refused"),
        ({"files": "deny"}, "FILE_TRANSFER_PROTOCOL", {"target_system": 3}, 'files is "deny"', "no file transfers"),
        ({"rates_hz": {4: 0.0}}, "PING", {}, "third_party.rates.PING is 0", "refused on this radio: PING"),
    ],
)
def test_a_refusal_is_told_once_with_its_key_and_to_the_station_in_the_vehicles_name(
    rules: dict[str, Any], name: str, values: dict[str, Any], sentence: str, text: str
) -> None:
    watched = Watched(**rules)
    watched.offer(name, 3, **values)
    (event,) = watched.events
    assert event.kind == "third_party"
    assert event.text.startswith("radio radio: 255/190 (station, bound) ")
    assert sentence in event.text and "links.radio.third_party." in event.text
    assert (event.data["source"], event.data["message"]) == ("255/190", name)
    (message,) = watched.sent["station"]
    shown = message.info.unpack(message.payload)["text"]
    assert text in shown and len(shown) <= TEXT_BYTES
    assert (message.sysid, message.compid) == (values.get("target_system", 255), 25)
    assert not watched.sent["bound"] and not watched.sent["radio"]


def test_what_waits_for_another_vehicle_is_told_with_how_far_that_is() -> None:
    watched = Watched()
    watched.offer("PARAM_REQUEST_LIST", target_system=1)
    watched.air.third_party.on_param_value(1, 1, 4, 900, 0.1)
    watched.offer("PARAM_REQUEST_LIST", target_system=2)
    watched.offer("FILE_TRANSFER_PROTOCOL", target_system=1)
    watched.offer("FILE_TRANSFER_PROTOCOL", target_system=2)
    lists, files = watched.events
    assert "while another's list is under way (1's: 1 of 900)" in lists.text
    assert "asks vehicle 2 for files while those of 1 come" in files.text


def test_without_timeslots_the_arithmetic_is_that_of_the_serial_port() -> None:
    watched = Watched(air_kbps=None)
    watched.offer("LOG_REQUEST_DATA", target_system=3)
    assert "at the 2880 B/s that one vehicle can send, 10 MB take 1.0 h" in watched.events[0].text


def test_whose_heartbeats_are_needless_depends_on_whether_ours_go() -> None:
    assert Watched().air.third_party.own_sysid == 255
    assert Watched(heartbeat=False).air.third_party.own_sysid is None
