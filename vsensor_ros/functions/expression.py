"""
The safe expression language of plant and design files.

Numbers, names, `pi`, + - * / **, parentheses and the functions of the catalogue; nothing
else is accepted and nothing is ever executed: the text is read by Python's parser into a
syntax tree, the tree is walked against a whitelist, and what is kept is three small node
types that compile to closures over numpy.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import difflib
import keyword
import math
import re
from types import MappingProxyType
from typing import Any
import warnings

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.functions.catalogue import CATALOGUE
from vsensor_ros.functions.function import Function
from vsensor_ros.functions.operators import OPERATORS
from vsensor_ros.functions.table import pieces, TABLES, wrong_points

MAX_CHARACTERS = 8000  # a table of a hundred points
MAX_DEPTH = 50
DIGITS = 6  # of numbers in words
CONSTANTS = {'pi': math.pi}
_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*')


@dataclass(frozen=True)
class Number:
    """A finite constant; as what a person wrote it, where that was no number: k, 2*pi."""

    value: float
    written: Node | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class Name:
    """A variable."""

    id: str


@dataclass(frozen=True)
class Apply:
    """A function of the catalogue, or an operator (+ - * / ** neg), applied."""

    function: str
    arguments: tuple[Node, ...]
    called: str = field(default='', compare=False, repr=False)  # of a table: its own name


Node = Number | Name | Apply
Tables = Mapping[str, tuple[str, tuple[Node, ...]]]  # by name: 'table' or .., and its points
Closure = Callable[[Any], Any]

NO_TABLES: Tables = MappingProxyType({})

_BINARY: dict[type, str] = {ast.Add: '+', ast.Sub: '-', ast.Mult: '*', ast.Div: '/',
                            ast.Pow: '**'}
_WORDS: dict[type, str] = {
    ast.Attribute: 'an attribute (a dot after a name)', ast.Lambda: 'lambda',
    ast.Compare: 'a comparison', ast.IfExp: 'if ... else',
    ast.BoolOp: 'and / or', ast.BitXor: '^ (a power is written **)',
    ast.Tuple: 'a comma (a decimal is written with a point)', ast.Mod: '%',
    ast.FloorDiv: '//', ast.MatMult: '@', ast.ListComp: 'a comprehension',
    ast.SetComp: 'a comprehension', ast.DictComp: 'a comprehension',
    ast.GeneratorExp: 'a comprehension', ast.List: 'a list', ast.NamedExpr: ':=',
    ast.JoinedStr: 'a text', ast.Not: 'not', ast.Starred: 'a star', ast.keyword: 'a keyword'}


def _allowed() -> str:
    return ('use numbers, names, pi, + - * / **, parentheses and the functions '
            + ', '.join(CATALOGUE))


def parse(text: str | float, where: object = 'expression', key: str = '',
          known: Iterable[str] | None = None, tables: Tables = NO_TABLES) -> Node:
    """
    Read an expression; a plain number is one too.

    known: the names it may use (all when None); tables: those that it may call by name.
    Raises BadInput when anything outside the language is in it, naming that and what is
    allowed, and when a constant part of it has no finite value.
    """
    if isinstance(text, (int, float)) and not isinstance(text, bool):
        if text != text or text in (math.inf, -math.inf):
            raise BadInput(where, key, f'{text} is not finite', 'give a finite number')
        text = repr(text)
    if not isinstance(text, str):
        raise BadInput(where, key, f'{shown(text)} is not an expression', _allowed())
    if len(text) > MAX_CHARACTERS:
        raise BadInput(where, key, f'the expression has {len(text)} characters',
                       f'keep it within {MAX_CHARACTERS}')
    text = ' '.join(text.split())
    if not text:
        raise BadInput(where, key, 'the expression is empty', _allowed())
    if not text.isascii() or '#' in text:
        strange = next(c for c in text if not c.isascii() or c == '#')
        raise BadInput(where, key, f'{shown(strange)} is not in the language', _allowed())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            tree = ast.parse(text, mode='eval').body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else 'nested too deeply'
        raise BadInput(where, key, f'{shown(text)} cannot be read ({reason})',
                       _allowed()) from None
    node = _whitelisted(tree, where, key, 1, tables)
    if known is not None:
        check_names(node, known, where, key)
    fold(node, where, key)
    return node


def check_name(name: object, where: object, key: str) -> str:
    """Return the name; raise BadInput unless it is an identifier the language can use."""
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise BadInput(where, key, f'{shown(name)} is not a name',
                       'use letters, digits and _, beginning with a letter')
    if keyword.iskeyword(name) or name in CATALOGUE or name in CONSTANTS or name in TABLES:
        raise BadInput(where, key, f'{name} is a word of the expression language',
                       f'choose another name, such as {name}_')
    return name


def check_names(node: Node, known: Iterable[str], where: object = 'expression',
                key: str = '') -> None:
    """Raise BadInput, with the known names in it, when a node uses another name."""
    known = list(known)
    for name in names(node):
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            raise BadInput(where, key, f'unknown name {shown(name)}',
                           (f'did you mean {near[0]}? ' if near else '')
                           + 'known names: ' + (', '.join(known) or 'none'))


def _whitelisted(tree: ast.AST, where: object, key: str, depth: int, tables: Tables) -> Node:
    def inner(part: ast.AST) -> Node:
        return _whitelisted(part, where, key, depth + 1, tables)

    def refused(what: str) -> BadInput:
        return BadInput(where, key, f'{what} is not in the language', _allowed())

    if depth > MAX_DEPTH:
        raise BadInput(where, key, f'the expression is nested more than {MAX_DEPTH} deep',
                       'bracket long sums into parts')
    if isinstance(tree, ast.Constant):
        if not isinstance(tree.value, (int, float)) or isinstance(tree.value, bool):
            raise refused(shown(tree.value))
        try:
            value = float(tree.value)
        except OverflowError:
            value = math.inf
        if not math.isfinite(value):
            raise BadInput(where, key, 'a number in it is too large', 'keep it below 1e308')
        return Number(value)
    if isinstance(tree, ast.Name):
        if tree.id in CATALOGUE or tree.id in tables:
            raise BadInput(where, key, f'{tree.id} is a function',
                           f'write {tree.id}(...) or rename the variable')
        return Number(CONSTANTS[tree.id], Name(tree.id)) if tree.id in CONSTANTS \
            else Name(tree.id)
    if isinstance(tree, ast.Subscript):
        return Name(_indexed(tree, refused))
    if isinstance(tree, ast.BinOp):
        if type(tree.op) not in _BINARY:
            raise refused(_word(tree.op))
        return Apply(_BINARY[type(tree.op)], (inner(tree.left), inner(tree.right)))
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, (ast.USub, ast.UAdd)):
        operand = inner(tree.operand)
        return negate(operand) if isinstance(tree.op, ast.USub) else operand
    if isinstance(tree, ast.Call):
        if not isinstance(tree.func, ast.Name):
            raise refused('a call of a call' if isinstance(tree.func, ast.Call)
                          else _word(tree.func))
        name = tree.func.id
        if name in TABLES and tree.args and not tree.keywords:
            return table_node(name, *map(inner, tree.args), where=where, key=key)
        if name not in CATALOGUE and name not in tables:
            near = difflib.get_close_matches(name, (*tables, *CATALOGUE), 1)
            hint = f'did you mean {near[0]}? ' if near else ''
            raise BadInput(where, key, f'the function {shown(name)} is not in the language',
                           hint + _allowed())
        strange = [a for a in tree.args if isinstance(a, ast.Starred)] + tree.keywords
        if strange:
            raise refused(_word(strange[0]))
        arity = 1 if name in tables else CATALOGUE[name].arity
        if len(tree.args) != arity:
            raise BadInput(where, key, f'{name} is given {len(tree.args)} arguments',
                           f'it takes {arity}')
        arguments = tuple(map(inner, tree.args))
        if name in tables:
            kind, points = tables[name]
            return Apply(kind, (*arguments, *points), name)
        return Apply(name, arguments)
    raise refused(_word(tree.op if isinstance(tree, ast.UnaryOp) else tree))


def _indexed(tree: ast.expr, refused: Callable[[str], BadInput]) -> str:
    """Return the name of an element of an array: 'k[0]', 'k[1][2]'."""
    if isinstance(tree, ast.Name):
        return tree.id
    if not isinstance(tree, ast.Subscript):
        raise refused('an index of what is no name')
    index = tree.slice.elts if isinstance(tree.slice, ast.Tuple) else [tree.slice]
    whole = [i.value for i in index if isinstance(i, ast.Constant) and type(i.value) is int]
    if len(whole) < len(index):
        raise refused('an index that is no whole number')
    return _indexed(tree.value, refused) + ''.join(f'[{i:d}]' for i in whole)


def table_node(name: str, of: Node, *points: Node, where: object, key: str) -> Node:
    """Return a lookup table of a node; raise BadInput unless the points are numbers that rise."""
    numbers = [point.value for point in points if isinstance(point, Number)]
    wrong = 'holds a point that is no number' if len(numbers) < len(points) \
        else wrong_points(numbers)
    if wrong:
        raise BadInput(where, key, f'the table {wrong}', 'give [x, y] by rising x')
    return Apply(name, (of, *points), 'table')  # its points are too many for words


def _word(tree: ast.AST) -> str:
    return _WORDS.get(type(tree), type(tree).__name__)


def negate(node: Node) -> Node:
    """Return -node; a number stays a number."""
    if isinstance(node, Number):
        return Number(-node.value, node.written and Apply('neg', (node.written,)))
    return Apply('neg', (node,))


def to_text(node: Node) -> str:
    """Print a node so that parse gives the same node again."""
    return _printed(node, False)[0]


def to_words(node: Node) -> str:
    """Print a node as a person wrote it: parameters and tables by name, numbers rounded."""
    return _printed(node, True)[0]


def _printed(node: Node, words: bool) -> tuple[str, int]:
    if isinstance(node, Name):
        return node.id, 5
    if isinstance(node, Number):
        if words and node.written is not None:
            return _printed(node.written, words)
        text = f'{node.value:.{DIGITS}g}' if words else repr(float(node.value))
        negative = text.startswith('-')
        return text[:-2] if text.endswith('.0') else text, 3 if negative else 5
    if words and node.called:
        return f'{node.called}({_printed(node.arguments[0], words)[0]})', 5
    own = function_of(node).precedence
    if own is None:
        inner = ', '.join(_printed(a, words)[0] for a in node.arguments)
        return f'{node.function}({inner})', 5

    def side(argument: Node, at_least: int) -> str:
        text, precedence = _printed(argument, words)
        return text if precedence >= at_least else f'({text})'

    if node.function == 'neg':  # -2*x is the same number as -(2*x)
        return '-' + side(node.arguments[0], own - words), own - words
    left, right = node.arguments
    if words and node.function == '*' and _printed(left, words)[0] == '1':
        return _printed(right, words)  # a factor that is one but for rounding
    if node.function == '**':
        return f'{side(left, 5)}**{side(right, 3)}', own
    space = ' ' if own == 1 else ''
    return f'{side(left, own)}{space}{node.function}{space}{side(right, own + 1)}', own


def walk(node: Node) -> Iterator[Node]:
    """Go through a node and all its parts."""
    yield node
    if isinstance(node, Apply):
        for argument in node.arguments:
            yield from walk(argument)


def names(node: Node) -> tuple[str, ...]:
    """Return the names in a node, in order of first appearance."""
    return tuple(dict.fromkeys(part.id for part in walk(node) if isinstance(part, Name)))


def substitute(node: Node, values: Mapping[str, Node | float]) -> Node:
    """Replace names, all at once."""
    if isinstance(node, Name) and node.id in values:
        value = values[node.id]
        return Number(float(value), node) if isinstance(value, (int, float)) else value
    if isinstance(node, Apply):
        return replace(node, arguments=tuple(substitute(a, values) for a in node.arguments))
    return node


def fold(node: Node, where: object = 'expression', key: str = '') -> Node:
    """
    Replace every constant part by its number.

    Raises BadInput when such a part is not finite, and where the constants alone put a
    function outside its domain: a divisor that is 0, limits in the wrong order.
    """
    if not isinstance(node, Apply):
        return node
    arguments = tuple(fold(a, where, key) for a in node.arguments)
    folded = replace(node, arguments=arguments)
    function = function_of(node)
    numbers = _constants(arguments)
    with np.errstate(all='ignore'):
        outside = function.outside is not None and bool(function.outside(*numbers))
        if not outside and not all(isinstance(a, Number) for a in arguments):
            return folded
        value = float(function.value(*numbers))
    if outside or not math.isfinite(value):
        why = f'domain: {function.domain}' if outside else 'too large'
        raise BadInput(where, key, f'{shown(to_text(folded))} has no value ({why})',
                       'correct the numbers or parameters in it')
    by_name = any(isinstance(a, Number) and a.written for a in arguments)
    return Number(value, folded if by_name or node.called else None)


def function_of(node: Apply) -> Function:
    """Return the catalogue entry of what a node applies."""
    return OPERATORS.get(node.function) or CATALOGUE.get(node.function) or TABLES[node.function]


def compile_node(node: Node, fetch: Mapping[str, Closure]) -> Closure:
    """
    Turn a node into a closure; fetch gives each name's value from the closure's argument.

    Overflow warns as numpy does: wrap a hot loop in np.errstate(all='ignore') once.
    """
    if isinstance(node, Number):
        value = node.value
        return lambda at: value
    if isinstance(node, Name):
        return fetch[node.id]
    function = function_of(node).value
    if node.function in TABLES:
        table = pieces(node.function == 'smooth_table', tuple(_constants(node.arguments[1:])))
        of = compile_node(node.arguments[0], fetch)
        return lambda at: table(of(at))
    if len(node.arguments) == 1:
        only = compile_node(node.arguments[0], fetch)
        return lambda at: function(only(at))
    if len(node.arguments) == 2:
        left, right = (compile_node(a, fetch) for a in node.arguments)
        return lambda at: function(left(at), right(at))
    parts = tuple(compile_node(a, fetch) for a in node.arguments)
    return lambda at: function(*[part(at) for part in parts])


def domain_limited(node: Apply) -> bool:
    """Whether some arguments lie outside the domain of what the node applies."""
    return function_of(node).limited(*_constants(node.arguments))


def _constants(arguments: Iterable[Node]) -> list[float]:
    # NaN stands for what is not known yet and lies in every domain
    return [a.value if isinstance(a, Number) else math.nan for a in arguments]


def compile_outside(node: Node, fetch: Mapping[str, Closure]) -> Closure | None:
    """Return a closure: does any function see arguments outside its domain? None: never."""
    checks: list[tuple[Callable[..., Any], tuple[Closure, ...]]] = []
    for part in walk(node):
        if isinstance(part, Apply) and domain_limited(part):
            outside = function_of(part).outside
            assert outside is not None
            checks.append((outside, tuple(compile_node(a, fetch) for a in part.arguments)))
    if not checks:
        return None

    def anywhere(at: Any) -> Any:
        result: Any = False
        for outside, arguments in checks:
            result = result | outside(*[argument(at) for argument in arguments])
        return result
    return anywhere


def compile_expression(expression: Node | str | float,
                       variables: Sequence[str]) -> Callable[[Sequence[Any]], np.ndarray]:
    """
    Return f(values) of an expression over the variables, elementwise over arrays.

    values: one number or array a variable, in the order of the variables.
    Raises BadInput for a text outside the language or a name that is no variable.
    """
    node = expression if isinstance(expression, (Number, Name, Apply)) else parse(expression)
    check_names(node, variables)
    node = fold(node)
    run = compile_node(node, {name: _item(i) for i, name in enumerate(variables)})
    return lambda values: np.asarray(run(values))


def _item(index: int) -> Closure:
    return lambda values: values[index]


def gradient(node: Node, at: Mapping[str, float],
             variables: Sequence[str]) -> tuple[float, np.ndarray]:
    """
    Return value and exact partial derivatives at a point; not finite at a kink.

    at: a number for every name; the derivatives are by the variables, in their order.
    """
    if isinstance(node, Number):
        return node.value, np.zeros(len(variables))
    if isinstance(node, Name):
        return float(at[node.id]), np.array([float(node.id == v) for v in variables])
    parts = [gradient(a, at, variables) for a in node.arguments]
    function = function_of(node)
    values = [np.float64(value) for value, _ in parts]
    total = np.zeros(len(variables))
    with np.errstate(all='ignore'):
        for slope, (_, inner) in zip(function.slopes, parts):
            moved = inner != 0.0    # a slope that meets no change must not spoil the sum
            if moved.any():
                total[moved] += float(slope(*values)) * inner[moved]
        return float(function.value(*values)), total
