"""What would happen if each sensor failed now, as the replacer's own engine says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

from vsensor_ros.commissioning.findings import FAIL, Finding, INPUT, NOTE, Use, WARN
from vsensor_ros.engine import ChannelState
from vsensor_ros.node.reserve import Chance, chance
from vsensor_ros.observers import Design, Refusal
from vsensor_ros.reason import Reason


@dataclass(frozen=True)
class Outlook:
    """What would become of one sensor."""

    name: str
    level: int  # as of findings
    text: str
    replaced: bool = True  # the design has a virtual sensor for it


def outlook(state: ChannelState, reserve: tuple[tuple[str, ...], float] | None, design: Design,
            uses: Sequence[Use], findings: Sequence[Finding], faulty: Sequence[str]) -> Outlook:
    """
    Say what would become of a sensor; reserve: who would speak for it, and its deviation.

    faulty: the sensors that are now; what nothing replaces beside these is not so by design.

    Why nobody could is explained by what was found of the topic that is missing.
    """
    name, why = state.name, state.reserve
    if (refused := _refused(name, design)) is not None:
        return Outlook(name, NOTE, f'not replaced, by design: {_short(refused)}', False)
    hope = chance(why)
    if why is None or hope is Chance.PASSES:
        text = _ready(state, reserve, design) if why is None else f'virtual sensor warms up: {why}'
        return Outlook(name, NOTE, text) if _speaks(name, uses) else Outlook(
            name, WARN, f'is not heard itself; {text}')
    if hope is Chance.NEVER and not faulty:
        return Outlook(name, NOTE, f'not replaced, by design: {why}', False)
    while why.code == 'next best':
        why = why.fact('next' if chance(why.fact('exact')) is Chance.NEVER else 'exact')
    cause = _cause(name, why, uses, findings)
    return Outlook(name, FAIL, f'cannot be replaced now: {cause or why}')


def _speaks(name: str, uses: Sequence[Use]) -> bool:
    """Tell whether a sensor itself was heard, with a number."""
    return any(use.role == INPUT and name in use.channels and use.heard is not None
               and use.fields[use.channels[name]].found for use in uses)


def _ready(state: ChannelState, reserve: tuple[tuple[str, ...], float] | None,
           design: Design) -> str:
    text = 'virtual sensor ready'
    if reserve is None:
        return text
    fault_set, deviation = reserve
    if math.isfinite(deviation):
        text += f', good to {deviation:.2g} {state.unit}'.rstrip()
    entry = design.entries.get((fault_set, state.name))
    if entry is not None and not isinstance(entry, Refusal):
        text += f', from {", ".join((*entry.reads, *entry.commands)) or "nothing"}'
        if entry.grade == 'bounded':
            text += '; unknown inputs still disturb it'
    return text


def _refused(name: str, design: Design) -> str | None:
    """Return why a sensor can never be replaced when it fails, alone or not; None: it can."""
    entries = [e for (fault_set, channel), e in design.entries.items()
               if channel == name and name in fault_set]
    if any(not isinstance(e, Refusal) for e in entries):
        return None
    return next((e.reason for e in entries if isinstance(e, Refusal)), 'nothing was designed')


def _cause(name: str, why: Reason, uses: Sequence[Use],
           findings: Sequence[Finding]) -> Finding | None:
    """Return what was found of the input that a virtual sensor lacks, or of the clock of all."""
    for finding in findings:
        if finding.level == FAIL and finding.topics == ('/clock',):
            return finding
    facts: Mapping[str, object] = dict(why.facts)
    missing = facts.get('name', name)
    topics = {use.topic for use in uses if missing in use.channels}
    about = [f for f in findings if f.level >= WARN and topics & set(f.topics)
             and f.channel in ('', missing)]
    return max(about, key=lambda f: (f.level, f.channel == missing), default=None)


def _short(text: str) -> str:
    return text if len(text) <= 160 else f'{text[:157]}...'
