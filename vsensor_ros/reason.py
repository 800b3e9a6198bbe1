"""
Why something is not so, as data: a code and facts.

Logic asks for the code and the facts; people are shown ``str(reason)``. The sentences of the
machine stand here. A room or a kind with codes of its own adds its sentences (`add_sentences`), so
that the machine does not load those of the desk.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

_YEAR = 3e7  # s
Sentence = str | Callable[..., str]  # {fact} stands for a fact; or called with the facts

EPOCH = 1e9  # s since 1970; a clock that shows less counts from something else


def _another_clock(name: str, seconds: float, clock: float) -> str:
    """Say how far [s] the stamps of an input are ahead of this node's clock, which shows that."""
    off = f'{abs(seconds):.{1 if abs(seconds) < 60.0 else 0}f} s ' + (
        'ahead of' if seconds > 0.0 else 'behind')
    if abs(seconds) < 60.0:
        return f'{name} speaks, but its stamps are {off} the clock of this node'
    guess = ''
    if clock + seconds < EPOCH < clock:
        guess = ': time since boot, or of a simulation?'
    elif clock < EPOCH < clock + seconds:
        guess = ', which is simulated'
    return f"{name} speaks, but its stamps are of another clock ({off} this node's{guess})"


SENTENCES: dict[str, Sentence] = {
    # of readings and commands that are not used
    'not finite': 'not finite',
    'ahead of the clock': 'stamp ahead of the clock',
    'isolated': 'isolated',
    'duplicate stamp': 'duplicate stamp',
    'stamp runs backwards': 'stamp runs backwards',
    'no angle': 'so many turns that its angle is lost',
    # of commands
    'command not used': '{name}: {why}, so the last one is not used; mend who commands it',
    'command of another clock': lambda name, seconds: f'{name}: its stamps are {_lead(seconds)} '
    f'the clock of this node, so it counts from its arrival; mend the clock of who commands it',
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
    'input of another clock': _another_clock,
    'command ended': '{name} ended {seconds:.1f} s ago; commands.{name}.at_end says what counts '
    'then',
    'command unusable': 'nothing of {name} could be used for {seconds:.1f} s',
    'estimate not finite': 'its estimate is not finite',
    'lost on its way': 'states that are as likely have gone far from it since the loss: nothing '
    'is known of its error',
    'about to start': 'starts with the next step',
    'too uncertain': 'its standard deviation {deviation:.3g} is above max_deviation {limit:.3g}',
    'not tracked yet': 'its channel was lost before it was known well enough to go on without it, '
    'or it started anew since',
    'tracked too long ago': 'its last good state is {seconds:.1f} s old, and only {kept:.1f} s '
    'are kept',
    'catching up': 'is being brought to now from its last good state, some steps at each tick',
    'track lost': 'readings that it needs were missing since its channel was lost',
    'served its time': 'served its time, until its channel is believed again: {why}',
    'beyond the tolerance': 'its standard deviation {deviation:.3g} is above the tolerance '
    '{limit:.3g}',
    'beyond a tenth of the range': 'its standard deviation {deviation:.3g} is above a tenth of '
    'the range, {limit:.3g}',
    'no limit': 'it would serve for a time only, and no limit says for how long',
    'worse than designed': 'it erred by {measured:.3g} beside the healthy sensor, more than '
    '{limit:.3g}: it was designed for {figure:.3g}',
    'not clearly good': 'its standard deviation was beyond the limit; it serves again below '
    '{limit:.3g}, now it is {deviation:.3g}',
    # of faulty sensors: why they are not believed
    'silent': 'silent',
    'recovering': 'healthy again, believed after {dwell:g} s without a fault',
    'held': 'healthy again, held until cleared',
    'latched': 'latched until reset',
    'forced': 'forced',
    'named': '{name} ({why})',
    # of channels: why they are served as they are
    'no design': 'no design for the loss of {failed}',
    'ready again': 'ready again for {seconds:.1f} s, serves after {dwell:.1f} s',
    'ready just now': 'was not ready until just now',
    'next best': '{exact}; that for {fault_set}: {next}',
    'served by a superset': '{why}; {exact}',
    'serves early': '{why}; {left}',
    'less sure': 'the design for {fault_set} is good to {deviation:.3g} only',
    'had its time': 'it has served its time, until its channel is believed again',
    'force waits': 'force waits: {why}',
    'force waits for another': 'force waits: {harmed}: {why}',
    'force ended': 'force ended: {why}',
    'force ended for another': 'force ended: {harmed}: {why}',
    'instead': '{why}; {instead}',
    'both': '{first}; {second}',
    # what goes out for a channel that nobody serves
    'stop': 'nothing goes out',
    'hold': 'the last value goes out',
    'nan': 'NaN goes out',
    'pass': 'the failed reading goes out',
    # of messages: why they do not say what they should, or did not go on
    'unreadable': 'bytes that are not a message of the type',
    'not in the message': '{field} is not in the message',
    'too short': 'the array is too short for {field}',
    'disowned': '{field} is marked as not there ({mark})',
    'no rotation': 'the quaternion of {field} is no rotation: all zeros, or not normalised',
    'does not fit': '{value} does not fit into {field} ({type})',
    'only NaN': 'nothing but NaN arrives',
    'only NaN on': 'nothing but NaN arrives on {topic}',
    'nothing comes': 'nothing comes on {topic}',
    'useless messages': 'messages arrive on {topic}, but {why}',
    'stale messages': 'messages arrive on {topic}, but are {why}',
    'driver silent': 'its driver has been silent for {seconds:.1f} s',
    'not newer': 'not sent on: not newer than what went out',
    'not chosen': 'from another publisher than the one chosen',
    'withheld': '{count} of its messages in {seconds:g} s {why}',
    'never seen': 'no message of its driver was ever seen, so frame and names are not known',
    'not sent': 'not sent: {text}',
    'mistake': 'a mistake of this node ({error})',
    'clock stands still': 'the clock stands still: no /clock since {seconds:.1f} s',
    'trace': '{text}',
    # what is said now and then
    'counted': '{name}: {why} ({count} so far)',
    'clock jumped ahead': 'the clock jumped ahead by {seconds:.1f} s; all virtual sensors start '
    'anew',
    'clock jumped back': 'the clock jumped back by {seconds:.1f} s; all virtual sensors start '
    'anew',
    'faulty sensors': 'faulty sensors: {names}',
    'slow sensor': '{name}: its readings are {seconds:.3g} s apart, so between them it counts as '
    'silent after {max_age:.3g} s; raise max_age',
    'stamps step back': 'the stamps on {topic} stay {seconds:.1f} s behind what went out on '
    '{output}: they step back there now; mend the clock of the driver',
    'clock of its own': 'the stamps on {topic} are {seconds:+.1f} s from the clock of this node; '
    'the estimates in their place follow them',
}


def _lead(seconds: float) -> str:
    if seconds < -_YEAR:
        return 'of another kind than'  # since boot, say
    return f'{abs(seconds):.3g} s {"ahead of" if seconds > 0.0 else "behind"}'


@dataclass(frozen=True)
class Reason:
    """One reason: its code, a key of SENTENCES, and the facts that the sentence names."""

    code: str
    facts: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of(cls, code: str, **facts: Any) -> Reason:
        """Make a reason; a fact may be a reason itself, or a tuple, which is listed."""
        return cls(code, tuple(facts.items()))

    def fact(self, name: str) -> Any:
        """Return one of the facts."""
        return dict(self.facts)[name]

    def __str__(self) -> str:
        sentence = SENTENCES.get(self.code, self.code)
        if not isinstance(sentence, str):
            return sentence(**dict(self.facts))
        return sentence.format(**{
            fact: ', '.join(map(str, value)) if isinstance(value, tuple) else value
            for fact, value in self.facts})


def add_sentences(sentences: Mapping[str, Sentence]) -> None:
    """Make the sentences of more codes known; raises ValueError when a code is taken."""
    for code, sentence in sentences.items():
        if SENTENCES.setdefault(code, sentence) is not sentence:
            raise ValueError(f'{code}: there is a sentence for this code already')
