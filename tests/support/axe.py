"""axe-core, Deque's checks of accessibility, on a page of the browser tests."""

from __future__ import annotations

from playwright.sync_api import Page

from support.process import ROOT

AXE = ROOT / "src/skygcs/web/page/node_modules/axe-core/axe.min.js"

RUN = """async () => {
    const brief = ({ target, html }) => `${target} ${html.replace(/ (class|title)="[^"]*"/g, "").slice(0, 260)}`;
    const { violations } = await axe.run(document, { resultTypes: ["violations"] });
    return violations.map(({ id, nodes }) => `${id}: ${nodes.slice(0, 3).map(brief).join(" | ")}`);
}"""


def findings(page: Page) -> list[str]:
    """What axe finds on the screen as it is."""
    found: list[str] = page.evaluate(RUN)
    return found
