"""Which events are alarms, what belongs to one cause, and what is kept of acknowledged ones."""

from __future__ import annotations

import contextlib
import json
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.alarms import (
    CONSEQUENCES,
    MAX_ALARMS,
    RULES,
    SEVERITIES,
    Alarms,
    Signal,
    VehicleFacts,
    battery,
    severity_of,
    signals,
    with_severity,
)
from skygcs.events import Event
from skygcs.rpc.client import EVENT_KINDS
from support.table import each

FLYING, STANDING = VehicleFacts(True), VehicleFacts(False)


def event(kind: str, vehicle: str | None = "a", text: str = "text", **data: Any) -> Event:
    return Event(kind, vehicle, 1, text, data)


def happen(alarms: Alarms, *events: Event, now: float = 100.0, facts: VehicleFacts = FLYING) -> list[str]:
    """The kinds of alarms of which a person is told anew."""
    found = [alarms.take(signal, now) for one in events for signal in signals(one, facts)]
    return [alarm.kind for alarm in found if alarm is not None]


MEETS = event("separation", level="warning", **{"with": "b"})
PARTS = event("separation", level=None, **{"with": "b"})

CASES = {
    "lost": (event("vehicle_lost", age_s=3.0), event("vehicle_back")),
    "deaf": (event("uplink_lost"), event("uplink_back")),
    "failsafe": (event("failsafe", failsafe=True), event("failsafe", failsafe=False)),
    "stop": (event("command", order="stop", ok=False, result="denied"), event("command", order="land", ok=True)),
    "takeoff": (event("takeoff"), event("disarmed")),
    "return": (event("command", order="rtl", result="failed"), event("command", order="rtl", ok=True)),
    "guard": (event("control", state="held"), event("control", state="flying")),
    "fence": (event("fence", outside=True), event("fence", outside=False)),
    "separation": (MEETS, PARTS),
    "recorder": (event("recorder", None, recording=False), event("recorder", None, recording=True)),
    "keys": (event("companion", None, change="keys_kept"), event("companion", None, change="keys_read")),
    "unwatched": (event("separation", watched=False), event("separation", watched=True)),
    "duplicate": (event("duplicate", change="duplicate"), event("duplicate", change="duplicate_over")),
    "plan": (event("plan", None, state="stopped"), event("plan", None, state="flying")),
    "unattended": (event("unattended"), None),
    "ground": (event("ground_lost"), None),
    "operator": (event("warning", None, action="rtl", vehicles=["a"]), None),
    "autopilot": (event("statustext", level=1), None),
    "fault": (event("fault"), None),
}
"""By kind of alarm: what raises it, and what ends it; None: only a person does."""


@each("kind", CASES)
def test_each_kind_is_raised_once_counted_and_ends(kind: str) -> None:
    raised, over = CASES[kind]
    alarms = Alarms()
    assert happen(alarms, raised) == [kind]
    assert happen(alarms, raised) == [], "counted, and no news"
    (alarm,) = alarms.all()
    assert (alarm.kind, alarm.count, alarm.open) == (kind, 2, True)
    assert alarm.active is (over is not None)
    if over is not None:
        assert happen(alarms, over) == []
        assert not alarm.active and alarms.all() == [alarm], "it stays until somebody has seen it"
        assert happen(alarms, raised) == [kind], "and is news again"
        happen(alarms, over)
    assert alarms.acknowledge(None, "mia", 200.0) == [alarm]
    assert alarms.all() == [] and (alarm.acknowledged_by, alarm.acknowledged_unix_s) == ("mia", 200.0)


def test_what_is_no_alarm_raises_none() -> None:
    orders = (("stop", True, None), ("arm", False, None), ("stop", False, "cancelled"), ("rtl", False, "failed"))
    quiet = [
        *(event("command", order=order, ok=ok, result=result) for order, ok, result in orders),
        *(event("command", order=order, result="in_progress") for order in ("stop", "rtl")),
        event("statustext", level=4),
        event("statustext", text="PreArm: Compass not healthy", level=2),
        event("separation", level="notice", **{"with": "b"}),
        event("warning", text="a disk is slow"),
        event("plan", None),
        event("fence", text="fence set"),
        event("fence", text="the record of a fence test", breached=True),
        event("mode"),
    ]
    assert happen(Alarms(), *quiet) == []
    assert set(RULES) <= {*EVENT_KINDS, "plan"}


def test_a_hold_ends_no_alarm_of_a_return_that_was_given_up() -> None:
    """It holds already, and nobody sends it home by that."""
    alarms = Alarms()
    orders = event("command", order="rtl", result="failed"), event("command", order="hold", ok=True)
    assert happen(alarms, *orders) == ["return"]
    assert [alarm.active for alarm in alarms.all()] == [True]


def test_one_loss_is_one_alarm() -> None:
    """It was 20 separation events around one vehicle."""
    alarms, blind = Alarms(), event("separation", watched=False)
    meets = [event("separation", f"v{n}", level="warning", **{"with": "a"}) for n in range(10)]
    assert happen(alarms, *meets[:2], blind, now=95.0) == ["separation", "separation", "unwatched"]
    assert happen(alarms, event("vehicle_lost"), now=100.0) == ["lost"]
    assert happen(alarms, *meets, event("uplink_lost"), blind, now=101.0) == []
    (alarm,) = alarms.all()
    assert alarm.consequences == {"separation": 12, "unwatched": 2, "deaf": 1}
    others = event("separation", "b", level="action", **{"with": "c"})
    assert happen(alarms, others, event("failsafe")) == ["separation", "failsafe"], "of others, or no consequence"
    # one that was seen before, or began long before, stays what it is
    alarms = Alarms()
    happen(alarms, meets[0], now=10.0)
    happen(alarms, meets[1], now=95.0)
    alarms.acknowledge([2], "mia", 96.0)
    happen(alarms, event("vehicle_lost"), now=100.0)
    assert [alarm.kind for alarm in alarms.all()] == ["lost", "separation", "separation"]
    happen(alarms, event("vehicle_back"))
    assert happen(alarms, meets[5], now=130.0) == ["separation"], "heard again and forgotten"


def test_an_acknowledged_alarm_is_news_when_it_gets_worse_and_leaves_when_it_is_over() -> None:
    alarms = Alarms()
    low = battery("a", 20.0, (25.0, 12.0), FLYING)
    assert low is not None and low.severity == "warning" and alarms.take(low, 1.0) is not None
    alarms.acknowledge(None, "mia", 2.0)
    assert alarms.take(low, 3.0) is None
    (alarm,) = alarms.all()
    assert not alarm.open and alarm.active
    critical = battery("a", 0.0, (25.0, 12.0), FLYING)
    assert critical is not None and alarms.take(critical, 4.0) is alarm
    assert alarm.open and alarm.severity == "alarm" and "0 %" in alarm.text
    alarms.acknowledge([alarm.number], "mia", 5.0)
    assert battery("a", 26.0, (25.0, 12.0), FLYING) is None, "hysteresis"
    full = battery("a", 90.0, (25.0, 12.0), FLYING)
    assert full is not None and alarms.take(full, 6.0) is None
    assert alarms.all() == []
    standing = battery("a", 0.0, (25.0, 12.0), STANDING)
    assert standing is not None and standing.severity == "warning"


def test_alarms_outlive_a_restart() -> None:
    alarms = Alarms()
    happen(alarms, event("vehicle_lost", text="lost\x1b[31m"), event("failsafe", "b"))
    alarms.acknowledge([1], "mia", 101.0)
    again = Alarms()
    again.restore(json.loads(json.dumps(alarms.saved())))
    assert [(a.number, a.kind, a.acknowledged_by) for a in again.all()] == [(2, "failsafe", None), (1, "lost", "mia")]
    assert "\x1b" not in again.all()[1].text
    assert happen(again, event("vehicle_lost")) == [], "it is lost still, and was seen"
    assert happen(again, event("vehicle_lost", "c")) == ["lost"]
    assert again.all()[0].number == 3
    happen(again, event("vehicle_discovered"))
    assert [a.vehicle for a in again.all()] == ["c", "b"]


KEYS = st.sampled_from(["format", "last", "alarms", "number", "kind", "vehicle"])
ANYTHING = st.recursive(
    st.none() | st.integers() | st.text() | st.floats(), lambda inner: st.lists(inner) | st.dictionaries(KEYS, inner)
)


@given(ANYTHING)
def test_any_file_is_taken_or_refused(saved: Any) -> None:
    with contextlib.suppress(ValueError, TypeError, KeyError, AttributeError, OverflowError):
        Alarms().restore(saved)


def test_the_number_of_alarms_is_bounded_and_those_that_last_stay() -> None:
    alarms = Alarms()
    happen(alarms, event("vehicle_lost", "first"))
    for n in range(2 * MAX_ALARMS):
        alarms.take(Signal("separation", f"v{n}", True, severity="warning"), float(n))
        alarms.take(Signal("separation", f"v{n}", False), float(n))
    assert len(alarms.all()) == MAX_ALARMS and alarms.displaced == MAX_ALARMS + 1
    assert any(alarm.vehicle == "first" for alarm in alarms.all())


def test_a_cause_is_no_consequence_of_its_own_consequence() -> None:
    for cause, effects in CONSEQUENCES.items():
        assert not any(cause in CONSEQUENCES.get(effect, ()) for effect in effects)


SEVERITY_CASES = {
    "a failsafe": (event("failsafe", failsafe=True), FLYING, "alarm"),
    "its end": (event("failsafe", failsafe=False), FLYING, "info"),
    "lost in the air": (event("vehicle_lost", age_s=3.0), FLYING, "alarm"),
    "lost, nobody knows where": (event("vehicle_lost", age_s=3.0), VehicleFacts(), "alarm"),
    "lost on the ground": (event("vehicle_lost", age_s=3.0), STANDING, "warning"),
    "lost, and forgotten": (event("vehicle_lost", forgotten=True), FLYING, "warning"),
    "a conflict that comes": (event("separation", level="notice"), FLYING, "warning"),
    "a conflict": (event("separation", level="action"), FLYING, "alarm"),
    "a conflict's end": (event("separation", level="none"), FLYING, "info"),
    "the recorder stopped": (event("recorder", None, recording=False, error="no space"), FLYING, "alarm"),
    "the recorder lost something": (event("recorder", None, recording=True, lost=12), FLYING, "warning"),
    "the recorder is back": (event("recorder", None, recording=True, lost=0), FLYING, "info"),
    "a fence that was set": (event("fence", order="set"), FLYING, "info"),
    "a stop that was not obeyed": (event("command", order="stop", ok=False, result="timeout"), FLYING, "alarm"),
    "a stop that was cancelled": (event("command", order="stop", ok=False, result="cancelled"), FLYING, "warning"),
    "an order that failed": (event("command", outcome={"ok": False}), FLYING, "warning"),
    "an order that was denied": (event("command", result="denied"), FLYING, "warning"),
    "an order that was done": (event("command", result="accepted"), FLYING, "info"),
    "a critical text": (event("statustext", text="Crash: Disarming", level=1), FLYING, "alarm"),
    "a critical text on the ground": (event("statustext", text="Crash: Disarming", level=1), STANDING, "warning"),
    "a refusal to arm": (event("statustext", text="PreArm: Compass not calibrated", level=2), FLYING, "warning"),
    "a warning text": (event("statustext", level=4), FLYING, "warning"),
    "a plain text": (event("statustext", level=6), FLYING, "info"),
    "a text without a level": (event("statustext", level="none"), FLYING, "info"),
    "nobody at the controls": (event("warning", None, action="land", vehicles=["a"]), FLYING, "alarm"),
    "a warning": (event("warning", None), FLYING, "warning"),
    "a link that broke": (event("link_down", None), FLYING, "warning"),
    "a link that has reached its end": (event("link_down", None, finished=True), FLYING, "info"),
    "an alarm of a state": (event("alarm", change="raised", logged=False, severity="alarm"), FLYING, "alarm"),
    "an alarm of an event": (event("alarm", change="raised", logged=True, severity="alarm"), FLYING, "info"),
    "an alarm that was seen": (event("alarm", change="acknowledged", logged=True, severity="alarm"), FLYING, "info"),
    "a kind that nobody knows": (event("unheard_of"), FLYING, "info"),
}


@each("what", SEVERITY_CASES)
def test_an_event_is_as_serious_as_the_alarm_it_raises(what: str) -> None:
    given, facts, severity = SEVERITY_CASES[what]
    assert severity_of(given, facts) == severity


@each("kind", CASES)
def test_what_ends_an_alarm_is_no_alarm(kind: str) -> None:
    begun, ended = CASES[kind]
    assert severity_of(begun, FLYING) == next(s.severity for s in signals(begun, FLYING) if s.raised)
    assert ended is None or severity_of(ended, FLYING) == "info"


@each("data", [{"outcome": "none"}, {"order": {}}, {"result": [], "ok": 1}, None, "text", {"level": {}}])
def test_a_record_of_another_daemon_with_any_data_has_a_severity(data: Any) -> None:
    for kind in [*RULES, "alarm", "recorder"]:
        record = {"kind": kind, "vehicle": "a", "sysid": 1, "text": "text", "data": data}
        assert with_severity(record)["severity"] in SEVERITIES
