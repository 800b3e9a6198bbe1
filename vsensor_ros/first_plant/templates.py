"""Plant files of common machines, to be filled in: their comments stay."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math
from pathlib import Path
import re
from types import MappingProxyType

import yaml

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.plant import read_yaml
from vsensor_ros.plant.checked import suggestion
from vsensor_ros.text_file import read_text

_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*')


def templates(folder: Path) -> dict[str, str]:
    """Return the templates of a folder by name, each with the sentence that says what it is."""
    return {path.stem: read_yaml(path)['description'] for path in sorted(folder.glob('*.yaml'))}


def filled(folder: Path, template: str, name: str | None = None,
           values: Mapping[str, str] = MappingProxyType({})) -> str:
    """
    Return the text of a template with the plant's name and values of parameters put in.

    A `spread` is scaled with its value, and so is `fit` where the value is not within. Raises
    BadInput for a name that there is not, and for what is no number.
    """
    known = templates(folder)
    if template not in known:
        raise BadInput('', '', f'there is no template {shown(template)}',
                       suggestion(template, [*known, 'arm']))
    text = read_text(folder / f'{template}.yaml', '', 'install the package anew', 2**20)
    changes: list[tuple[yaml.Node, str]] = []
    top = _entries(yaml.compose(text, yaml.SafeLoader))
    if name is not None:
        changes.append((top['name'], checked_name(name)))
    parameters = _entries(top['parameters'])
    for parameter, value in values.items():
        if parameter not in parameters:
            raise BadInput('', '--set', f'{shown(parameter)} is no parameter of {template}',
                           suggestion(parameter, parameters))
        changes += _set(_entries(parameters[parameter]), parameter, value)
    for node, new in sorted(changes, key=lambda change: -change[0].start_mark.index):
        text = text[:node.start_mark.index] + new + text[node.end_mark.index:]
    return text


def checked_name(name: str) -> str:
    """Return the name of a plant; BadInput unless it may stand in a topic and a file name."""
    if not _NAME.fullmatch(name):
        raise BadInput('', '--name', f'{shown(name)} is not a name',
                       'use letters, digits and _, beginning with a letter')
    return name


def _entries(node: yaml.Node) -> dict[str, yaml.Node]:
    """Return what a mapping holds by key; a bare value is as {value: ..}."""
    if not isinstance(node, yaml.MappingNode):
        return {'value': node}
    return {key.value: value for key, value in node.value}


def _set(entry: Mapping[str, yaml.Node], parameter: str,
         value: str) -> Iterator[tuple[yaml.Node, str]]:
    """Yield what is to be changed where a parameter stands, and to what."""
    new, old = number(value, f'--set {parameter}'), float(entry['value'].value)
    yield entry['value'], repr(new)
    beside = [entry['spread']] if 'spread' in entry and new else []
    if 'fit' in entry:
        low, high = (float(side.value) for side in entry['fit'].value)
        beside += [] if low <= new <= high else entry['fit'].value
    ratio = new / old
    if beside and not ratio > 0.0:
        raise BadInput('', f'--set {parameter}', f'{value} has not the sign of {old:g}, and what '
                       'stands beside it is of that sign', 'set another, and edit the file then')
    for node in beside:
        yield node, f'{float(node.value) * ratio:.6g}'


def number(text: str, key: str) -> float:
    """Read a finite number of a command line."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInput('', key, f'{shown(text)} is not a number',
                       'give one such as 0.02, in the unit of the plant file')
    return value
