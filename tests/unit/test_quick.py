"""A change leads to the tests of its room: those that it edits, those of the same name, those that import it."""

from __future__ import annotations

from quick.choice import BUDGET_CPU_S, choose, module_name

TESTS = {
    "tests/unit/core/routing/test_router.py": "from skygcs.core.routing import router",
    "tests/unit/core/routing/test_router_ways.py": "import skygcs.core.routing.router",
    "tests/unit/core/routing/test_filters.py": "from skygcs.core.routing.filters import Filter",
    "tests/unit/runtime/test_hub.py": "def lazily():\n    from skygcs.core.routing.router import Router",
    "tests/unit/test_docs_names.py": "",
    "tests/integration/test_links.py": "from support.frames import frame",
}


def test_a_module_leads_to_its_own_tests_and_to_those_that_import_it() -> None:
    assert choose(["src/skygcs/core/routing/router.py"], TESTS, {}).run == (
        "tests/unit/core/routing/test_router.py",
        "tests/unit/core/routing/test_router_ways.py",
        "tests/unit/runtime/test_hub.py",
    )
    assert choose(["tests/support/frames.py"], TESTS, {}).run == ("tests/integration/test_links.py",)
    assert choose(["docs/guard.md"], TESTS, {}).run == ("tests/unit/test_docs_names.py",)
    assert choose(["src/skygcs/links/_fast_path.c"], TESTS, {}).run == ()


def test_what_was_edited_runs_at_any_cost_and_the_rest_while_the_budget_lasts() -> None:
    changed = ["tests/unit/core/routing/test_filters.py", "src/skygcs/core/routing/router.py"]
    filters, router, ways, hub = (f"tests/unit/{name}.py" for name in (
        "core/routing/test_filters", "core/routing/test_router", "core/routing/test_router_ways", "runtime/test_hub"
    ))  # fmt: skip
    cpu_s = {filters: BUDGET_CPU_S - 10, router: 20.0, ways: 7.0, hub: 2.0}
    chosen = choose(changed, TESTS, cpu_s)
    assert chosen.run == (filters, ways, hub)
    assert chosen.left_out == (router,)


def test_names_of_modules() -> None:
    assert module_name("src/skygcs/core/routing/__init__.py") == "skygcs.core.routing"
    assert module_name("tests/support/frames.py") == "support.frames"
    assert module_name("build_page.py") is None
