"""The line of every key, where tomllib gives none."""

from __future__ import annotations

import tomllib

from hypothesis import given
from hypothesis import strategies as st

from skygcs.config.tables import key_lines, line_of

TEXT = '''a = 1 # [no]
"q=#u".b = """
[neither]
x = 1
"""
[[t]]
k = [ "]", # ]
  [1,
 2]]
[x."y.z"] # c
# m = 3
'm'.z = {a = 1, b = 2}
s = \'\'\'
[no]\'\'\'
[e]
'''


def test_headers_keys_and_what_only_looks_like_them() -> None:
    assert key_lines(TEXT) == {
        ("a",): 1,
        ("q=#u",): 2,
        ("q=#u", "b"): 2,
        ("t",): 6,
        ("t", "k"): 7,
        ("x",): 10,
        ("x", "y.z"): 10,
        ("x", "y.z", "m"): 12,
        ("x", "y.z", "m", "z"): 12,
        ("x", "y.z", "s"): 13,
        ("e",): 15,
    }


def test_a_key_without_a_line_has_that_of_what_holds_it() -> None:
    lines = key_lines(TEXT)
    assert line_of(("x", "y.z", "m", "z", "b"), lines) == 12
    assert line_of(("x", "y.z", "absent"), lines) == 10
    assert line_of(("t", "k", 1), lines) == 7
    assert line_of((), lines) is None
    assert line_of(("absent",), lines) is None


PIECES = st.sampled_from(
    [
        "[a]\n",
        "[b.c]\n",
        "x = 1\n",
        'y = "[z]"\n',
        'm = """\n',
        '"""\n',
        "l = [\n",
        "1,\n",
        "]\n",
        "# [q]\n",
        "k.j = '='\n",
    ]
)


@given(st.lists(PIECES, max_size=14, unique=True).map("".join))
def test_every_key_of_an_accepted_text_stands_in_the_line_given(text: str) -> None:
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    lines = key_lines(text)
    for path, line in lines.items():
        assert str(path[-1]) in text.split("\n")[line - 1]
    assert {path[0] for path in lines} == set(table)
