"""Which code of skygcs is installed: two checkouts of one version differ, and a companion's is not seen.

The same function runs here and, as source text, in the Python of the companion's installation: an older skygcs there
need not have it.
"""

from __future__ import annotations

import inspect
from pathlib import Path

import skygcs


def content_of(folder: str) -> str:
    """The first 12 digits of a SHA-256 over all Python files of a package: their paths in it, and their bytes. Neither
    compiled parts, which differ by architecture, nor the web page count."""
    import hashlib
    import os

    found = []
    for place, _, files in os.walk(folder):
        for name in files:
            if name.endswith(".py"):
                path = os.path.join(place, name)
                found.append((os.path.relpath(path, folder).replace(os.sep, "/"), path))
    digest = hashlib.sha256()
    for inside, path in sorted(found):
        with open(path, "rb") as file:
            data = file.read()
        digest.update(f"{inside} {len(data)}\n".encode() + data)
    return digest.hexdigest()[:12]


def own_content() -> str:
    """The content of this skygcs."""
    return content_of(str(Path(skygcs.__file__).parent))


REMOTE = (
    inspect.getsource(content_of)
    + """
import importlib.util
found = importlib.util.find_spec("skygcs")
print(content_of(list(found.submodule_search_locations)[0]) if found else "")
"""
)
"""A program for a Python there: prints the content of the skygcs that it has."""
