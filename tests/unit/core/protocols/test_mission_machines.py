"""The mission exchanges against a peer that says anything at any time: what they promise whatever comes."""

from __future__ import annotations

from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.core.protocols.base import Effect, Finish, Send
from skygcs.core.protocols.mission import MAX_ROUNDS as DOWNLOAD_ROUNDS
from skygcs.core.protocols.mission import MAX_TRIES, MissionClear, MissionDownload, MissionProtocol
from skygcs.core.protocols.mission_upload import ANSWERS_PER_ITEM, MAX_ROUNDS, MissionUpload
from support.examples import examples
from support.table import each

COUNT = 3
ITEMS = [MissionItem(16, 3, (float(n), None, 0.0, None), 437800000 + n, -794600000, 10.0 + n) for n in range(COUNT)]
OTHER = MissionItem(21, 3, (0.0, 0.0, 0.0, 0.0), 437800000, -794600000, 0.0)
ACKS = (0, 0, 0, 0, 1, 1, 13, 13, 15, 4, 12, 99)
"""More often those that do not end it at once."""

LIMIT = MAX_ROUNDS * (MAX_TRIES + DOWNLOAD_ROUNDS * MAX_TRIES * (COUNT + 2)) + (ANSWERS_PER_ITEM + 1) * COUNT
"""Messages that any of the exchanges may send at most."""


class AnyPeer(RuleBasedStateMachine):
    """One exchange of one kind; the kinds are the subclasses."""

    def make(self) -> MissionProtocol:
        raise NotImplementedError

    @initialize()
    def begin(self) -> None:
        self.exchange = self.make()
        self.now = 50.0
        self.sent: list[Send] = []
        self.finished = 0
        self.asked: set[int] = set()
        self.take(self.exchange.start(self.now))

    def take(self, effects: tuple[Effect, ...]) -> None:
        self.sent += [e for e in effects if isinstance(e, Send)]
        self.finished += sum(isinstance(e, Finish) for e in effects)
        for effect in effects:
            if isinstance(effect, Send):
                assert effect.values["mission_type"] == self.exchange.kind

    @rule(seconds=st.floats(0.01, 8.0))
    def time_passes(self, seconds: float) -> None:
        """The shell calls the timer when it is due, however late the next message comes."""
        end = self.now + seconds
        while (due := self.exchange.deadline) is not None and due <= end:
            self.now = max(self.now, due)
            self.take(self.exchange.on_timer(self.now))
        self.now = end

    @rule()
    def the_timer_is_early(self) -> None:
        due = self.exchange.deadline
        if due is not None and due > self.now:
            assert self.exchange.on_timer(self.now) == ()

    @rule(seq=st.integers(0, COUNT + 1))
    def it_asks(self, seq: int) -> None:
        effects = self.exchange.on_request(seq, self.now)
        items = [e for e in effects if isinstance(e, Send) and e.message == "MISSION_ITEM_INT"]
        assert [e.values["seq"] for e in items] in ([], [seq])
        self.asked |= {e.values["seq"] for e in items}
        self.take(effects)

    @rule(result=st.sampled_from(ACKS), number=st.none() | st.integers(1, 9))
    def it_acknowledges(self, result: int, number: int | None) -> None:
        self.take(self.exchange.on_ack(result, self.now, number))

    @rule(count=st.integers(0, COUNT + 1), number=st.none() | st.just(7))
    def it_counts(self, count: int, number: int | None) -> None:
        self.take(self.exchange.on_count(count, self.now, number))

    @rule(seq=st.integers(0, COUNT), right=st.booleans())
    def it_gives(self, seq: int, right: bool) -> None:
        item = ITEMS[seq] if right and seq < COUNT else OTHER
        self.take(self.exchange.on_item(seq, item.values(), self.now))

    @precondition(lambda self: not self.exchange.done)
    @rule(really=st.integers(0, 19))
    def it_is_cancelled(self, really: int) -> None:
        if really == 19:  # seldom: it ends the story
            self.take(self.exchange.stop(self.now, "cancelled", "cancelled"))
            assert self.exchange.done

    @invariant()
    def it_is_bounded(self) -> None:
        assert len(self.sent) <= LIMIT

    @invariant()
    def it_waits_or_is_over(self) -> None:
        assert (self.exchange.deadline is None) == self.exchange.done
        assert self.finished == self.exchange.done

    @invariant()
    def its_end_makes_sense(self) -> None:
        outcome = self.exchange.outcome
        if outcome is not None:
            assert outcome.message and outcome.ok == (outcome.result == "accepted")
            assert outcome.state in (("complete", "cleared") if outcome.ok else ("unchanged", "partial", "unknown"))

    def teardown(self) -> None:
        """Left alone, every exchange ends."""
        if hasattr(self, "exchange"):
            for _ in range(LIMIT):
                if self.exchange.deadline is not None:
                    self.now = max(self.now, self.exchange.deadline)
                    self.take(self.exchange.on_timer(self.now))
            assert self.exchange.done
            self.it_is_bounded()


class UploadToAny(AnyPeer):
    def make(self) -> MissionProtocol:
        return MissionUpload(MissionType.MISSION, ITEMS, keeps_old=False)

    @invariant()
    def nothing_is_taken_that_was_not_asked_for(self) -> None:
        outcome = self.exchange.outcome
        if outcome is not None and outcome.ok:
            assert self.asked == set(range(COUNT))


class DownloadFromAny(AnyPeer):
    def make(self) -> MissionProtocol:
        return MissionDownload(MissionType.FENCE)

    @invariant()
    def a_list_is_whole(self) -> None:
        outcome = self.exchange.outcome
        if outcome is not None and outcome.ok:
            assert outcome.items is not None
            asked = {e.values["seq"] for e in self.sent if e.message == "MISSION_REQUEST_INT"}
            assert set(range(len(outcome.items))) <= asked
            assert all(item in (OTHER, ITEMS[n] if n < COUNT else OTHER) for n, item in enumerate(outcome.items))

    @invariant()
    def reading_changes_nothing(self) -> None:
        assert {e.message for e in self.sent} <= {"MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_ACK"}


class ClearAny(AnyPeer):
    def make(self) -> MissionProtocol:
        return MissionClear(MissionType.RALLY)


@each("machine", [UploadToAny, DownloadFromAny, ClearAny])
def test_it_keeps_its_promises_whatever_comes(machine: Any) -> None:
    case = machine.TestCase()
    case.settings = settings(max_examples=examples(60), stateful_step_count=50)
    case.runTest()
