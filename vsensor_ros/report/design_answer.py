"""What the command designer answers: what can be lost, and what was found for each sensor."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import textwrap

from vsensor_ros.designer.location import Location
from vsensor_ros.observers import Design, Entry, Isolability, Refusal, VirtualSensor
from vsensor_ros.observers.kinds.functional import short_name
from vsensor_ros.plant import Plant
from vsensor_ros.report import design_text, for_a_time, isolability_text

MOST_PLACES = 8  # for a new sensor
MOST_GAPS = 12  # of what cannot be told apart
WIDTH = 99


def answer(result: Design, blocks: set[tuple[str, ...]] | None = None,
           places: Sequence[Location] | None = None, plant: Plant | None = None,
           advice: Sequence[str] = ()) -> str:
    """
    Return what a person reads: what can be lost, then a block for each of some fault sets.

    ``blocks``: fault sets to print blocks for, by default all. ``advice``: what is to be minded,
    besides the plant's remarks.
    """
    time = ('continuous time' if result.sample_time is None
            else f'sample time {result.sample_time:g} s')
    lines = [f'Plant {result.plant_name}, {time}, {len(result.states)} states', '']
    minded = [*(() if plant is None else plant.remarks), *advice]
    if minded:
        lines += ['Mind', *(line for text in minded for line in _hanging('-', text, 2)), '']
    if any(result.fault_sets):
        lines.append('Sensors that this plant can afford to lose at the same time')
    for size, sentences in design_text.loss_lines(result):
        for i, sentence in enumerate(sentences):
            lines += _hanging(size if i == 0 else '', sentence, 9)
    if places is not None and plant is not None:
        lines += ['', 'With one more sensor', *_places(places, plant)]
    if result.isolability is not None:
        lines += ['', *_isolated(result.isolability, result.sensors)]
    lines.append('')
    for (fault_set, channel), entry in result.entries.items():
        if blocks is None or fault_set in blocks:
            lines += textwrap.wrap(
                f'{design_text.title(result, fault_set, channel)}: {design_text.state_of(entry)}'
                f'{design_text.left_out(entry)}', WIDTH, subsequent_indent='    ',
                break_on_hyphens=False)
            lines += _refused(entry) if isinstance(entry, Refusal) else _facts(
                entry, result, plant)
            lines.append('')
    long = _long_terms(entry for (fault_set, _), entry in result.entries.items()
                       if blocks is None or fault_set in blocks)
    if long:
        lines += ['Terms', *(line for short, name in long.items()
                             for line in _hanging('', f'{short}: {name}', 0)), '']
    hidden = sum(blocks is not None and s not in blocks for s, _ in result.entries)
    if hidden:
        lines += [f'{hidden} more not printed: ask with --details SENSORS or --details all, or '
                  'have all in a file with --report out.html', '']
    return '\n'.join(lines).rstrip() + '\n'


def closing(result: Design) -> str:
    """Return how many can be replaced."""
    grades = [v.grade for v in result.virtual_sensors]
    some = ''.join(f', {grades.count(grade)} of them {how} only' for grade, how in
                   (('bounded', 'within a bound'), ('temporary', 'for a time')) if grade in grades)
    return f'{len(grades)} of {len(result.entries)} can be replaced{some}'


def _isolated(found: Isolability, sensors: Sequence[str]) -> list[str]:
    """Return whose fault can be told from whose, as a table where it has room."""
    lines = ['Whose fault it is: can one of the row be seen, and told from one of the column?']
    rows = isolability_text.table(found, sensors)
    columns = [isolability_text.SEEN, *sensors]
    widths = [max(len(name), 7) + 2 for name in columns]
    first = max(map(len, sensors)) + 2
    if first + sum(widths) <= WIDTH - 4:
        lines.append(' ' * (4 + first) + ''.join(
            f'{name:{w}}' for name, w in zip(columns, widths)).rstrip())
        lines += [f'    {s:{first}}' + ''.join(
            f'{mark:{w}}' for (_, mark), w in zip(row, widths)).rstrip()
            for s, row in zip(sensors, rows)]
        lines += _hanging('', isolability_text.KEY, 0)
    lines += _hanging('', isolability_text.summary(found), 0)
    for gap in found.gaps[:MOST_GAPS]:
        lines += _hanging('-', gap, 2)
    if len(found.gaps) > MOST_GAPS:
        lines.append(f'    - and {len(found.gaps) - MOST_GAPS} more, which are in the report')
    return lines


def _places(places: Sequence[Location], plant: Plant) -> list[str]:
    if not places:
        return ['    every state is measured already; second sensors, and sensors of unknown',
                '    inputs, are not looked at here']
    useful = [place for place in places if place.gained or place.isolable]
    if not useful:
        return ['    none of a single state would let you lose more than now']
    width = max(len(place.name) for place in useful[:MOST_PLACES]) + 2
    lines = []
    for place in useful[:MOST_PLACES]:
        said = [design_text.gained(place)] if place.gained else []
        said += [more] if (more := isolability_text.gained(place)) else []
        lines += _hanging(place.name, '; '.join(said), width)
    if len(useful) > MOST_PLACES:
        lines.append(f'    and {len(useful) - MOST_PLACES} more that help')
    return lines


def _hanging(head: str, text: str, width: int) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent=f'    {head:{width}}',
                         subsequent_indent=' ' * (4 + width), break_on_hyphens=False)


def _refused(entry: Refusal) -> list[str]:
    lines = [f'    {entry.reason}']
    if entry.alternative:
        lines.append(f'    instead: {entry.alternative}')
    return lines + [f'    in doubt: {doubt}' for doubt in entry.doubts]


def _facts(entry: Entry, result: Design, plant: Plant | None) -> list[str]:
    unit = result.units.get(entry.channel, '')
    if not isinstance(entry, VirtualSensor):
        return [line for name, value in design_text.facts(entry, unit)
                for line in _hanging(name, value, 18)]
    terms = [short_name(i, entry.terms[i].name) for i in entry.active
             if entry.terms[i].text != '1']  # an offset of the equations, which bends nothing
    if entry.grade == 'temporary':
        facts = _good_for(entry, result, plant)
    else:
        facts = [('noise error', design_text.noise(entry, unit)),
                 ('noise gain', design_text.number(entry.noise_gain))]
    facts = [
        ('order', design_text.order(entry)),
        facts[0],
        ('decay', design_text.decay(entry)),
        ('eigenvalues of N', design_text.eigenvalues(entry)),
        ('reads', design_text.reads(entry)),
        *facts[1:],
        ('found as', entry.method),
    ]
    if entry.grade == 'bounded':
        facts.insert(1, ('unknown inputs', design_text.disturbance(entry, unit)))
    if terms:
        facts.append(('nonlinear terms', ', '.join(terms)))
    facts += [('stability' if i == 0 else '', said)
              for i, said in enumerate(design_text.certificate(entry))]
    if len(entry.ladder) > 1:
        facts += [('ladder' if i == 0 else '', (
            f'order {rung.order}: noise error {design_text.number(rung.noise, unit)}, decay '
            f'{design_text.number(rung.decay, "1/s")}{" <- this one" if taken else ""}'))
            for i, (rung, taken) in enumerate(design_text.rungs(entry))]
    facts += [('in doubt', doubt) for doubt in design_text.doubts(entry)]
    return [line for name, value in facts for line in _hanging(name, value, 18)]


def _long_terms(entries: Iterable[Entry | Refusal]) -> dict[str, str]:
    """Return the names in full of terms that the blocks call by number, each once."""
    named = {i: entry.terms[i].name for entry in entries
             if isinstance(entry, VirtualSensor) for i in entry.active}
    return {short: name for i, name in sorted(named.items())
            if (short := short_name(i, name)) != name}


def _good_for(entry: VirtualSensor, result: Design, plant: Plant | None) -> list[tuple[str, str]]:
    """Say for how long a temporary one is good, and what a slow offset makes of that."""
    unit = result.units.get(entry.channel, '')
    allowed = for_a_time.tolerances(result, entry)
    facts = [('good', for_a_time.good_for(entry, allowed, unit))]
    learnt = '' if plant is None else for_a_time.learning(plant, entry, allowed, unit)
    return [*facts, ('slow offset', learnt)] if learnt else facts
