"""Kinds do not know each other, and nobody else knows a kind."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOM = ROOT / 'vsensor_ros' / 'observers'


def modules():
    """Return what each module of the room imports of the room, wherever in it that stands."""
    found = {}
    for path in ROOM.rglob('*.py'):
        parts = path.relative_to(ROOT).with_suffix('').parts
        name = '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)
        found[name] = {
            node.module for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
            if isinstance(node, ast.ImportFrom)
            and node.module.startswith('vsensor_ros.observers')}
    return found


def test_kinds_are_known_to_none_but_themselves_and_the_room():
    seam = 'vsensor_ros.observers.kinds'
    for name, imported in modules().items():
        for other in imported:
            kind = other.removeprefix(seam + '.').partition('.')[0]
            if other.startswith(seam + '.') and kind != 'batch':
                assert name == 'vsensor_ros.observers' or name.startswith(f'{seam}.{kind}')
