"""Output of a shell that waits for its client: bounded, the newest stays, and what was dropped is said."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from skygcs.ext.shell.shell_output import MAX_OUTPUT_BYTES, ShellOutput


def test_the_oldest_is_dropped_and_counted_once() -> None:
    output = ShellOutput()
    output.put(b"first")
    output.put(b"x" * MAX_OUTPUT_BYTES)
    assert output
    text, dropped = output.take()
    assert (text, dropped) == ("x" * MAX_OUTPUT_BYTES, 5)
    output.put(b"more")
    assert output.take() == ("more", 0)
    assert not output
    assert (output.received_bytes, output.dropped_bytes) == (MAX_OUTPUT_BYTES + 9, 5)


@given(st.text(max_size=200), st.lists(st.integers(1, 70), min_size=1))
def test_a_character_that_comes_in_two_frames_is_whole(text: str, sizes: list[int]) -> None:
    data, output, seen, n = text.encode("utf-8", "replace"), ShellOutput(), "", 0
    while data:
        size = sizes[n % len(sizes)]
        output.put(data[:size])
        data, n = data[size:], n + 1
        seen += output.take()[0]
    assert seen == text.encode("utf-8", "replace").decode()


@given(st.binary(max_size=300))
def test_bytes_that_are_no_text_do_no_harm(data: bytes) -> None:
    output = ShellOutput()
    output.put(data)
    assert isinstance(output.take()[0], str)
