"""The page's types are those of the daemon's methods.

As a program it prints src/skygcs/web/page/src/rpc_types.ts: PYTHONPATH=tests python tests/unit/web/test_page_types.py
"""

from __future__ import annotations

from support.extension_parts import ALL_METHODS
from support.page_types import TYPES, page_types


def test_the_pages_types_are_those_of_the_methods() -> None:
    assert TYPES.read_text(encoding="utf-8") == page_types(ALL_METHODS.values())


if __name__ == "__main__":
    print(page_types(ALL_METHODS.values()), end="")
