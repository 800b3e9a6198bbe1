"""
Why something is not so, as data: a code and facts. The sentences of all codes stand here.

Logic asks for the code and the facts; people are shown ``str(reason)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

SENTENCES = {
    # of readings and commands that are not used
    'not finite': 'not finite',
    'ahead of the clock': 'stamp ahead of the clock',
    'isolated': 'isolated',
    'duplicate stamp': 'duplicate stamp',
    'stamp runs backwards': 'stamp runs backwards',
    # of virtual sensors that have no estimate to serve with
    'not designed': 'no design for {channel} when {failed} failed',
    'refused': '{text}',
    'several rows': '{channel} has {rows} rows; design one for each',
    'start unknown': 'it is not known when it has forgotten its start',
    'converging': 'converging, {seconds:.1f} s more',
    'converging, not proved': 'converging, {seconds:.1f} s more (not proved)',
    'input isolated': '{name} is isolated',
    'no reading yet': 'no reading of {name} yet',
    'no command yet': 'no command of {name} yet',
    'input silent': '{name} silent for {seconds:.1f} s',
    'estimate not finite': 'its estimate is not finite',
    'expired': 'no longer good after {seconds:.1f} s',
    'about to start': 'starts with the next step',
}


@dataclass(frozen=True)
class Reason:
    """One reason: its code, a key of SENTENCES, and the facts that the sentence names."""

    code: str
    facts: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of(cls, code: str, **facts: Any) -> Reason:
        """Make a reason; a fact may be a reason itself."""
        return cls(code, tuple(facts.items()))

    def __getitem__(self, fact: str) -> Any:
        return dict(self.facts)[fact]

    def __str__(self) -> str:
        return SENTENCES[self.code].format(**dict(self.facts))
