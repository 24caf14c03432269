"""The rule for a parameter's value: one or more comparisons, their text, and a value that satisfies them."""

from __future__ import annotations

from dataclasses import dataclass

from skygcs.core.mavlink.param_encoding import Value, equal, value_text


@dataclass(frozen=True, slots=True)
class Rule:
    """All comparisons must hold. An empty rule accepts any value: it removes the rule of a lower level.

    ``one_of``: any of these values. ``least``, ``most``: bounds that belong to it. ``bits``, ``no_bits``: a mask of
    bits that must be set, or clear (whole numbers only). ``set_to``: what makes it right where the rule itself does not
    say enough. ``why`` is reported with a failure. ``optional``: a vehicle without such a parameter passes.
    """

    one_of: tuple[Value, ...] = ()
    least: Value | None = None
    most: Value | None = None
    bits: int = 0
    no_bits: int = 0
    set_to: Value | None = None
    why: str = ""
    optional: bool = False

    @property
    def empty(self) -> bool:
        return not (self.one_of or self.bits or self.no_bits) and self.least is None and self.most is None

    def holds(self, value: Value) -> bool:
        """True if a value that a vehicle holds satisfies the rule; a 32-bit float may differ in its last digit."""
        if self.one_of and not any(equal(value, wanted) for wanted in self.one_of):
            return False
        if self.least is not None and value < self.least and not equal(value, self.least):
            return False
        if self.most is not None and value > self.most and not equal(value, self.most):
            return False
        if not (self.bits or self.no_bits):
            return True
        return value == int(value) and int(value) & self.bits == self.bits and not int(value) & self.no_bits

    def fix(self, value: Value) -> Value | None:
        """The value to set, as near to the present one as the rule allows; None if the rule gives no single value."""
        if self.set_to is not None:
            wanted: Value | None = self.set_to
        elif self.one_of:
            wanted = next((v for v in self.one_of if self.holds(v)), None)
        else:
            wanted = value
            if self.bits or self.no_bits:
                wanted = (int(value) | self.bits) & ~self.no_bits
            if self.least is not None:
                wanted = max(wanted, self.least)
            if self.most is not None:
                wanted = min(wanted, self.most)
        return wanted if wanted is not None and self.holds(wanted) else None

    def __str__(self) -> str:
        """The rule as text that follows "must be": "0 or 2", "5 to 30", "at most 3000"."""
        parts = []
        if self.one_of:
            parts.append(" or ".join(map(value_text, self.one_of)))
        if self.least is not None and self.most is not None:
            parts.append(f"{value_text(self.least)} to {value_text(self.most)}")
        elif self.least is not None:
            parts.append(f"at least {value_text(self.least)}")
        elif self.most is not None:
            parts.append(f"at most {value_text(self.most)}")
        if self.bits:
            parts.append(f"with {_bit_list(self.bits)} set")
        if self.no_bits:
            parts.append(f"with {_bit_list(self.no_bits)} clear")
        return ", ".join(parts) or "anything"


def _bit_list(mask: int) -> str:
    numbers = [str(n) for n in range(mask.bit_length()) if mask >> n & 1]
    return f"bit{'s' if len(numbers) > 1 else ''} {' and '.join(numbers)}"
