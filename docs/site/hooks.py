"""What MkDocs shows otherwise than GitHub, made alike. MkDocs calls these functions while it builds the site."""

from __future__ import annotations

import re
from typing import Any

CODE = re.compile(r"<code>[^<]*</code>")


def on_page_content(html: str, **_: Any) -> str:
    """GitHub needs `\\|` for a bar in the code of a table's cell; Python-Markdown shows the backslash."""
    return CODE.sub(lambda code: code[0].replace("\\|", "|"), html)
