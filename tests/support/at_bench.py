"""A set-up procedure and an emulated radio at the two ends of a cable, in virtual time."""

from __future__ import annotations

from typing import TypeVar

from skygcs.ext.radio_tools.dialogue import Dialogue, Procedure
from skygcs.sim.at_modem import AtRadio

T = TypeVar("T")

TICK_S = 0.01
TIMEOUT_S = 600.0


class Cable:
    """The time goes on from one conversation to the next, as it does for a radio on a desk."""

    def __init__(self, radio: AtRadio, traffic: bytes = b"") -> None:
        self.radio = radio
        self.traffic = traffic
        """What comes over the air, every tenth of a second."""
        self.now = 100.0
        self.baud = 57600

    def run(self, procedure: Procedure[T], chunk: int = 7) -> T:
        """Carry it out; what it raises comes out. Bytes arrive ``chunk`` at a time, as they do on a serial port."""
        dialogue = Dialogue(procedure, self.now)
        end = self.now + TIMEOUT_S
        ticks = 0
        while not dialogue.done:
            assert self.now < end, "the procedure does not end"
            self.baud = dialogue.baud or self.baud
            if output := dialogue.take_output():
                self.radio.hear(output, self.now, self.baud)
            self.now += TICK_S
            ticks += 1
            if self.traffic and ticks % 10 == 0:
                self.radio.pass_on(self.traffic)
            self.radio.advance(self.now)
            heard = self.radio.take_output(self.baud)
            for start in range(0, len(heard), chunk):
                dialogue.feed(heard[start : start + chunk], self.now)
            deadline = dialogue.next_deadline()
            if deadline is not None and self.now >= deadline:
                dialogue.advance(self.now)
        if output := dialogue.take_output():
            self.radio.hear(output, self.now, self.baud)
        self.radio.advance(self.now)
        return dialogue.result
