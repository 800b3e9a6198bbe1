"""
A plant file with what a fit found, its comments and its order kept.

The libraries for that are the desk's: ruamel.yaml.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import StringIO
from pathlib import Path
from typing import Any

from vsensor_ros.bad_input import BadInput
from vsensor_ros.plant.plant_yaml import read_yaml
from vsensor_ros.text_file import read_text

LARGEST = 2**20  # bytes
WIDTH = 99


def open_text(path: str | Path) -> Any:
    """
    Return a plant file as a mapping that keeps comments; raise BadInput.

    What the project's own reader refuses (nested too deeply, aliases, no text) never reaches the
    library, whose round trip takes a tag for a comment and makes no object of it.
    """
    read_yaml(path)
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import YAMLError
    except ImportError:
        raise BadInput(path, '', 'cannot be written back: ruamel.yaml is not installed',
                       "install it: pip install 'vsensor_ros[fit]', or pip install ruamel.yaml",
                       ) from None
    text = read_text(path, '', 'name a plant file (YAML)', LARGEST)
    yaml = YAML(typ='rt')
    yaml.width, yaml.preserve_quotes = WIDTH, True
    try:
        return yaml.load(text)
    except YAMLError as error:
        raise BadInput(path, '', f'is not YAML ({str(error).splitlines()[0]})',
                       'correct it') from None


def written(content: Any) -> str:
    """Return the text of a mapping that open_text gave."""
    from ruamel.yaml import YAML
    yaml = YAML()
    yaml.width = WIDTH
    yaml.preserve_quotes = True
    yaml.indent(mapping=2, sequence=4, offset=2)
    out = StringIO()
    yaml.dump(content, out)
    return out.getvalue()


def put(content: Any, section: str, name: str, numbers: Mapping[str, float],
        short: str = '') -> None:
    """Set numbers of an entry; short: the key for which a bare value stands."""
    from ruamel.yaml.comments import CommentedMap
    entries = content[section]
    entry = entries.get(name)
    if not isinstance(entry, dict):
        made = CommentedMap({short: entry} if short and entry is not None else {})
        made.fa.set_flow_style()
        entries[name] = entry = made
    for key, value in numbers.items():
        if key in entry:
            entry[key] = value
        else:
            entry.insert(1 if key == 'spread' else len(entry), key, value)


def with_structure(content: Any, other: Mapping[str, Any]) -> None:
    """Take definitions and parameters of another content, where these differ."""
    from ruamel.yaml.comments import CommentedMap

    def flow(entry: Any) -> Any:
        made = CommentedMap({key: list(v) if isinstance(v, list) else v
                             for key, v in entry.items()})
        made.fa.set_flow_style()
        return made
    for name, entry in other.get('definitions', {}).items():
        if isinstance(entry, dict) and content['definitions'][name].get('value') != entry['value']:
            content['definitions'][name]['value'] = entry['value']
    parameters = content.setdefault('parameters', CommentedMap())
    for name in [name for name in parameters if name not in other['parameters']]:
        del parameters[name]
    for name, entry in other['parameters'].items():
        if name not in parameters:
            parameters[name] = flow(entry)
