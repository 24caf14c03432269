"""The channel that carries the poses of one vehicle: kept while it flies by them. Pure.

    it goes over      the ordinary choice now is   the vehicle    then it goes over
    ---------------   --------------------------   ------------   -----------------------------------------------
    any               another channel or none      does not fly   that one, or none
    none              another channel or none      flies          that one, or none
    one that is open  another one, or none         flies          the same; why it would be another one is noted
    one that closed   another channel or none      flies          that one, or none

A pose has no address, so the ordinary choice is a channel on which no other vehicle is heard. But what is heard is not
proven: a second autopilot with its ids on another link, or a forged heartbeat on its own, must not take the poses from
a vehicle that flies by them (`may_fly`). The other vehicle, if there is one, is not armed meanwhile.
"""

from __future__ import annotations


class PoseWay:
    """Call `choose` a few times a second."""

    __slots__ = ("channel_id", "kept_despite", "why_none")

    def __init__(self) -> None:
        self.channel_id: int | None = None
        """Where poses go; None: nowhere."""
        self.why_none = ""
        """Why they go nowhere."""
        self.kept_despite: str | None = None
        """Why they would not begin to go over this channel now; None: nothing speaks against it."""

    def choose(self, ordinary: int | None, why_not: str, *, flies: bool, still_open: bool) -> None:
        """``ordinary``: the channel by the ordinary choice, or None and ``why_not``; ``still_open``: the present
        channel is open and may be sent to."""
        if flies and still_open and self.channel_id is not None:
            self.kept_despite = why_not or None if ordinary is None else None
            self.why_none = ""
            return
        self.channel_id, self.why_none, self.kept_despite = ordinary, why_not, None
