"""Figures as files. matplotlib is an extra (`skygcs[plot]`) and is imported here only, on first use."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.errors import SkygcsError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS_PER_INCH = 120

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Okabe and Ito's colours, distinct for colour-blind people; dark enough on white."""


def require_matplotlib() -> None:
    """Raises SkygcsError that says how to get it."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise SkygcsError(
            "plots need matplotlib: pip install 'skygcs[plot]', or pip install '.[plot]' in a checkout"
        ) from None


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure that belongs to no window and no global state."""
    require_matplotlib()
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), dpi=DOTS_PER_INCH, layout="constrained")


def save(figure: Figure, path: Path) -> None:
    """Write it in the format of the path's suffix; the same figure gives the same bytes. Raises SkygcsError."""
    try:
        _write(figure, path, path.suffix.lower().removeprefix("."))
    except OSError as error:
        raise SkygcsError(f"{path}: {error.strerror or error}") from None


def svg(figure: Figure) -> str:
    """The figure as an SVG document, to be put into a page."""
    content = BytesIO()
    _write(figure, content, "svg")
    text = content.getvalue().decode()
    return text[text.index("<svg") :]


def _write(figure: Figure, file: Path | BytesIO, form: str) -> None:
    from matplotlib import rc_context
    from matplotlib.text import Text

    # no formulas, but then no logarithmic axes: a file's name, or a vehicle's text, may have two dollar signs
    for text in figure.findobj(Text):
        text.set_parse_math(False)
    metadata = {"Date": None} if form == "svg" else None
    with rc_context({"svg.hashsalt": "skygcs", "svg.fonttype": "none"}):
        figure.savefig(file, format=form, metadata=metadata)
