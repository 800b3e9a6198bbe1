"""Which names are alike, for people who misspell and for machines that name things otherwise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import difflib
import re

ALIKE = 0.75  # ratio from which two plain names are taken for one, misspelt
MOST = 1000  # names that are looked through; they come from outside


def words_of(name: str) -> tuple[str, ...]:
    """Take a name apart: ``/arm/joint_states1`` and ``jointStates01`` have joint, states and 1."""
    parts = re.findall(r'[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+', name)
    return tuple(part.lower().lstrip('0') or '0' for part in parts)


def plain(name: str) -> str:
    """Return a name without what people forget: case, slashes, underscores."""
    return re.sub(r'[^a-z0-9]', '', name.casefold())


def nearest(name: str, names: Iterable[str]) -> str | None:
    """Return the one that was most likely meant, or None."""
    best, at = None, ALIKE
    for other in list(names)[:MOST]:
        if other != name and (alike := _alike(name, other)) >= at:
            best, at = other, alike
    return best


def nearest_topic(topic: str, types: Mapping[str, str], wanted: str) -> str | None:
    """Return the topic that was most likely meant; those of the wanted type come first."""
    return nearest(topic, [t for t, kind in types.items() if kind == wanted]) or \
        nearest(topic, types)


def bracketed(name: str) -> str:
    """Return the name of an element as it stands in a field: in quotes where it needs them."""
    if re.fullmatch(r"""[^\[\]"'#0-9-][^\[\]"']*""", name):
        return f'[{name}]'
    return f"['{name}']" if '"' in name else f'["{name}"]'


def clean(text: str) -> str:
    """Return a text without what would steer a terminal or end a line: it comes from outside."""
    return ''.join(c if c.isprintable() else '?' for c in text)


def _alike(name: str, other: str) -> float:
    """Return how alike two names are: 2 when they differ in case and signs alone."""
    a, b = plain(name), plain(other)
    if a == b:
        return 2.0
    last, other_last = plain(name.rpartition('/')[2]), plain(other.rpartition('/')[2])
    if last == other_last and last:  # in another namespace
        return 1.0 + difflib.SequenceMatcher(None, a, b).ratio() / 2.0
    return difflib.SequenceMatcher(None, a, b).ratio()
