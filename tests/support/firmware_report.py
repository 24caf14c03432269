"""The report of a flight with real firmware: one row a scenario, as JSON and as a table, kept for comparison."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any


@dataclass
class Row:
    """One scenario. ``figures`` are what was measured, ``modes`` what each vehicle did."""

    scenario: str
    outcome: str = "running"
    seconds: float = 0.0
    figures: dict[str, Any] = field(default_factory=dict)
    modes: dict[str, list[str]] = field(default_factory=dict)
    reason: str = ""


class Report:
    """Written anew after every scenario, so that a run that is stopped leaves what it has."""

    def __init__(self, folder: Path, firmware: str, form: str) -> None:
        self._folder = folder
        self._began = time.strftime("%Y%m%d-%H%M%S")
        self._started = time.monotonic()
        self.firmware = firmware
        self.version = "unknown"
        self.form = form
        self.rows: list[Row] = []

    @property
    def run(self) -> str:
        """Names this run before its firmware's version is known."""
        return f"{self._began}-{self.firmware}-{self.form}"

    def file(self, suffix: str) -> Path:
        return self._folder / f"{self._began}-{self.firmware}-{self.version}-{self.form}.{suffix}"

    def add(self, row: Row) -> None:
        self.rows.append(row)
        self.write()

    def write(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        whole = {
            "firmware": self.firmware,
            "version": self.version,
            "form": self.form,
            "began": self._began,
            "rows": [asdict(row) for row in self.rows],
        }
        self.file("json").write_text(json.dumps(whole, indent=1) + "\n")
        self.file("txt").write_text(self.table())

    def table(self) -> str:
        lines = [f"{self.firmware} {self.version}, {self.form} form, {self._began}", ""]
        for row in self.rows:
            figures = ", ".join(f"{name} {_short(value)}" for name, value in row.figures.items())
            lines.append(f"{row.outcome:9}{row.seconds:7.1f} s  {row.scenario}")
            if figures:
                lines.append(f"{'':20}{figures}")
            for name, modes in row.modes.items():
                if len(modes) > 1:
                    lines.append(f"{'':20}{name}: {' > '.join(modes)}")
            if row.reason:
                lines.append(f"{'':20}{row.reason}")
        counts = {o: sum(r.outcome == o for r in self.rows) for o in sorted({r.outcome for r in self.rows})}
        spent_s = time.monotonic() - self._started
        lines += ["", f"{', '.join(f'{n} {outcome}' for outcome, n in counts.items())}; {spent_s / 60:.1f} minutes"]
        return "\n".join(lines) + "\n"


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} {_short(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_short(v) for v in value) + "]"
    return str(value)
