"""One-line changes of a module's functions: what a test of it must notice. Pure.

    kind         change
    ----------   ------------------------------------------------------------------------------------------------
    comparison   < and <=, > and >=, == and !=, is and is not, in and not in: each into the other
    arithmetic   + and -, * and /, // and %, & and |, << and >>: each into the other; += like +; -x into x
    logic        and into or, or into and, not x into x; the test of an if, while or conditional into its opposite
    number       a literal n into n + 1; True into False, and False into True
    removal      a statement that is a call, an assignment to an attribute or an item, or += into nothing; continue
                 into nothing, break into continue
    result       a returned value into None; not of True, False and None

What runs at import is left alone (constants, tables, defaults, decorators): a mutant replaces the code of functions.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

_OPPOSITE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
_INVERSE: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mod,
    ast.Mod: ast.FloorDiv,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}

_NO_EXPRESSIONS = ("annotation", "body", "orelse", "finalbody", "handlers", "cases", "returns")
"""Fields of a statement that hold other statements, or types."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """One changed line; its key outlives edits elsewhere in the file."""

    index: int
    line: int
    function: str
    before: str
    after: str
    nth: int
    """Which of several equal changes of equal lines in this function it is, from 0."""

    @property
    def key(self) -> str:
        again = f" #{self.nth}" if self.nth else ""
        return f"{self.function}: {self.before} -> {self.after}{again}"


def mutants(source: str) -> list[Mutant]:
    """Every change of every function, in the order of the file."""
    found: list[Mutant] = []
    seen: dict[tuple[str, str, str], int] = {}
    for index, place in enumerate(list(_places(ast.parse(source)))):
        before = ast.unparse(place.statement)
        place.apply()
        after = "nothing" if place.is_removal else ast.unparse(place.statement)
        place.undo()
        shown = _changed_line(before, after)
        key = (place.function, *shown)
        found.append(Mutant(index, place.line, place.function, *shown, seen.get(key, 0)))
        seen[key] = seen.get(key, 0) + 1
    return found


def changed_tree(source: str, mutant: Mutant) -> ast.Module:
    """The module's tree with that change of its `mutants`."""
    tree = ast.parse(source)
    place = next(itertools.islice(_places(tree), mutant.index, None))
    place.apply()
    return ast.fix_missing_locations(tree)


@dataclass(slots=True)
class _Place:
    """One change of a tree: an attribute of a node gets another value."""

    function: str
    statement: ast.stmt
    line: int
    node: ast.AST
    field: str
    value: object
    is_removal: bool = False
    _old: object = None

    def apply(self) -> None:
        self._old = getattr(self.node, self.field)
        setattr(self.node, self.field, self.value)

    def undo(self) -> None:
        setattr(self.node, self.field, self._old)


def _places(tree: ast.Module) -> Iterator[_Place]:
    for node in tree.body:
        yield from _in_definition(node, "")


def _in_definition(node: ast.stmt, prefix: str) -> Iterator[_Place]:
    if isinstance(node, ast.ClassDef):
        for inner in node.body:
            yield from _in_definition(inner, f"{prefix}{node.name}.")
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        yield from _in_bodies(node, f"{prefix}{node.name}")


def _in_bodies(parent: ast.AST, function: str) -> Iterator[_Place]:
    for field in ("body", "orelse", "finalbody"):
        statements = getattr(parent, field, [])
        for index, statement in enumerate(statements):
            if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
                yield from _in_bodies(statement, f"{function}.{statement.name}")
                continue
            if _is_removable(statement):
                rest = list(statements)
                rest[index] = ast.copy_location(ast.Pass(), statement)
                yield _Place(function, statement, statement.lineno, parent, field, rest, is_removal=True)
            yield from _in_statement(statement, function)
            yield from _in_bodies(statement, function)
    for part in [*getattr(parent, "handlers", []), *getattr(parent, "cases", [])]:
        yield from _in_bodies(part, function)


def _is_removable(statement: ast.stmt) -> bool:
    if isinstance(statement, ast.Expr):
        return isinstance(statement.value, ast.Call | ast.Await | ast.Yield | ast.YieldFrom)
    if isinstance(statement, ast.Assign):
        return all(isinstance(target, ast.Attribute | ast.Subscript) for target in statement.targets)
    return isinstance(statement, ast.AugAssign | ast.Delete | ast.Continue)


def _in_statement(statement: ast.stmt, function: str) -> Iterator[_Place]:
    """Changes in the statement's own expressions, not in those of the statements below it."""

    def at(node: ast.AST, name: str, value: object, *, line: int | None = None) -> _Place:
        return _Place(function, statement, line or getattr(node, "lineno", statement.lineno), node, name, value)

    if isinstance(statement, ast.Assert | ast.Raise | ast.Import | ast.ImportFrom):
        return
    if isinstance(statement, ast.If | ast.While):
        yield at(statement, "test", ast.UnaryOp(ast.Not(), statement.test), line=statement.test.lineno)
    if isinstance(statement, ast.Return) and statement.value is not None and not _is_result_kept(statement.value):
        yield at(statement, "value", ast.Constant(None))
    if isinstance(statement, ast.AugAssign) and type(statement.op) in _INVERSE:
        yield at(statement, "op", _INVERSE[type(statement.op)]())
    for node, parent, field, index in _expressions(statement):
        yield from _in_expression(node, at)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
            if index is None:
                yield at(parent, field, node.operand, line=node.lineno)
            else:
                siblings = list(getattr(parent, field))
                siblings[index] = node.operand
                yield at(parent, field, siblings, line=node.lineno)


def _in_expression(node: ast.expr, at: object) -> Iterator[_Place]:
    assert callable(at)
    match node:
        case ast.Compare(ops=ops):
            for index, op in enumerate(ops):
                if type(op) in _OPPOSITE:
                    yield at(node, "ops", [*ops[:index], _OPPOSITE[type(op)](), *ops[index + 1 :]])
        case ast.BinOp(op=op) if type(op) in _INVERSE and not isinstance(node.left, ast.JoinedStr):
            yield at(node, "op", _INVERSE[type(op)]())
        case ast.BoolOp(op=op):
            yield at(node, "op", ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.IfExp():
            yield at(node, "test", ast.UnaryOp(ast.Not(), node.test))
        case ast.Constant(value=bool(value)):
            yield at(node, "value", not value)
        case ast.Constant(value=int() | float() as value):
            yield at(node, "value", value + 1)


def _expressions(statement: ast.stmt) -> Iterator[tuple[ast.expr, ast.AST, str, int | None]]:
    """Each expression with its parent; f-strings, annotations and patterns of a match are left alone."""
    stack: list[ast.AST] = [statement]
    while stack:
        parent = stack.pop()
        for field, value in ast.iter_fields(parent):
            if field in _NO_EXPRESSIONS and not (isinstance(parent, ast.IfExp | ast.Lambda) and field != "annotation"):
                continue
            for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
                if isinstance(child, ast.JoinedStr | ast.pattern) or not isinstance(child, ast.AST):
                    continue
                if isinstance(child, ast.expr):
                    yield child, parent, field, index
                stack.append(child)


def _is_result_kept(value: ast.expr) -> bool:
    """True for None itself, and for truth values, which the kind `number` changes."""
    return isinstance(value, ast.Constant) and (value.value is None or isinstance(value.value, bool))


def _changed_line(before: str, after: str) -> tuple[str, str]:
    """The first line that differs, of both."""
    for old, new in zip(before.splitlines(), after.splitlines(), strict=False):
        if old != new:
            return old.strip(), new.strip()
    return before.splitlines()[0].strip(), (after.splitlines() or [""])[0].strip()
