"""What the command designer answers: what can be lost, and what was found for each sensor."""

from __future__ import annotations

from collections.abc import Sequence
import textwrap

from vsensor_ros.control import ClosedLoop
from vsensor_ros.designer.location import Location
from vsensor_ros.observers import (
    Design,
    Entry,
    FaultSizes,
    Isolability,
    Refusal,
    VirtualSensor,
)
from vsensor_ros.plant import Plant
from vsensor_ros.report import (
    design_text,
    fault_size_text,
    for_a_time,
    isolability_text,
    loop_text,
)

MOST_PLACES = 8  # for a new sensor
MOST_GAPS = 12  # of what cannot be told apart
WIDTH = 99


def answer(result: Design, blocks: set[tuple[str, ...]] | None = None,
           places: Sequence[Location] | None = None, plant: Plant | None = None,
           advice: Sequence[str] = (), loop: ClosedLoop | None = None) -> str:
    """
    Return what a person reads: what can be lost, then a block for each of some fault sets.

    ``blocks``: fault sets to print blocks for, by default all. ``advice``: what is to be minded,
    besides the plant's remarks. ``loop``: what becomes of a controller.
    """
    time = ('continuous time' if result.sample_time is None
            else f'sample time {result.sample_time:g} s')
    lines = [] if loop is None else [
        *(line for text in loop_text.headlines(loop) for line in textwrap.wrap(
            text, WIDTH, subsequent_indent='    ', break_on_hyphens=False)), '']
    lines += [f'Plant {result.plant_name}, {time}, {len(result.states)} states', '']
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
    if result.fault_sizes is not None:
        lines += ['', *_sized(result.fault_sizes, result)]
    if loop is not None:
        lines += ['', *_loop(loop, blocks, plant)]
    lines.append('')
    for (fault_set, channel), entry in result.entries.items():
        if (blocks is None or fault_set in blocks) and channel == entry.channel:
            lines += textwrap.wrap(
                f'{design_text.title(result, fault_set, channel)}: {design_text.state_of(entry)}'
                f'{design_text.left_out(entry)}', WIDTH, subsequent_indent='    ',
                break_on_hyphens=False)
            lines += _refused(entry) if isinstance(entry, Refusal) else _facts(
                entry, result, plant)
            lines.append('')
    said = ' '.join(' '.join(lines).split())
    called = [term for term in design_text.long_terms(result, plant) if term.short in said]
    if called:
        lines += ['Terms', *(line for term in called
                             for line in _hanging('', f'{term.short}: {term.name}', 0)), '']
    hidden = sum(blocks is not None and s not in blocks for s, _ in result.entries)
    if hidden:
        lines += [f'{hidden} more not printed: ask with --details SENSORS or --details all, or '
                  'have all in a file with --report out.html', '']
    return '\n'.join(lines).rstrip() + '\n'


def _loop(loop: ClosedLoop, blocks: set[tuple[str, ...]] | None,
          plant: Plant | None) -> list[str]:
    """Say what becomes of the loop: healthy, in fault sets with a block, and where it fails."""
    lines = textwrap.wrap(f'In the loop with {loop_text.closed_how(loop)}', WIDTH,
                          subsequent_indent='    ', break_on_hyphens=False)
    for case in loop.cases:
        if not case.lost or blocks is None or case.lost in blocks or not (
                case.holds or case.verdict == 'not replaced'):
            lines += textwrap.wrap(loop_text.title(case), WIDTH, initial_indent='    ',
                                   subsequent_indent=' ' * 8, break_on_hyphens=False)
            lines += [line for name, value in loop_text.facts(
                loop, case, plant, design_text.SHOWN) for line in textwrap.wrap(
                    value, WIDTH, initial_indent=f'        {name:16}',
                    subsequent_indent=' ' * 24, break_on_hyphens=False)]
    return lines + [line for text in loop_text.notes(loop) for line in _hanging('-', text, 2)]


def closing(result: Design) -> str:
    """Return how many can be replaced."""
    grades = [e.grade for e in result.entries.values() if not isinstance(e, Refusal)]
    some = ''.join(f', {grades.count(grade)} of them {how} only' for grade, how in
                   (('bounded', 'within a bound'), ('temporary', 'for a time'),
                    ('filtered', 'without proof')) if grade in grades)
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


def _sized(sizes: FaultSizes, result: Design) -> list[str]:
    """Return by which method the size of each fault is told, and what else there is."""
    rows = fault_size_text.rows(sizes, result.units)
    width = max(len(name) for name, _, _ in rows) + 2
    lines = [f'{fault_size_text.HEAD}, if it is the only one']
    for name, taken, others in rows:
        lines += _hanging(name, taken, width)
        if others:
            lines += _hanging('', f'({"; ".join(others)})', width)
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
    lines = textwrap.wrap(text, WIDTH, initial_indent=f'    {head:{width}}',
                          subsequent_indent=' ' * (4 + width), break_on_hyphens=False)
    return [line.replace(design_text.UNBROKEN, ' ') for line in lines]


def _refused(entry: Refusal) -> list[str]:
    said = [entry.reason, *([f'instead: {entry.alternative}'] if entry.alternative else []),
            *(f'in doubt: {doubt}' for doubt in entry.doubts)]
    return [line for text in said for line in _hanging('', text, 0)]


def _facts(entry: Entry, result: Design, plant: Plant | None) -> list[str]:
    unit = result.units.get(entry.channel, '')
    if not isinstance(entry, VirtualSensor):
        return [line for name, value in design_text.facts(entry, unit, result.units)
                for line in _hanging(name, value, 18)]
    terms = [entry.terms[i].short for i in entry.active
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
              for i, said in enumerate(design_text.certificate(entry, result.units))]
    if entry.why:
        facts.append(('alternatives', entry.why))
    if len(entry.ladder) > 1:
        facts += [('ladder' if i == 0 else '', (
            f'order {rung.order}: noise error {design_text.number(rung.noise, unit)}, decay '
            f'{design_text.rate(rung.decay, entry, "1/s")}{" <- this one" if taken else ""}'))
            for i, (rung, taken) in enumerate(design_text.rungs(entry))]
    facts += [('in doubt', doubt) for doubt in design_text.doubts(entry)]
    return [line for name, value in facts for line in _hanging(name, value, 18)]


def _good_for(entry: VirtualSensor, result: Design, plant: Plant | None) -> list[tuple[str, str]]:
    """Say for how long a temporary one is good, and what a slow offset makes of that."""
    unit = result.units.get(entry.channel, '')
    allowed = for_a_time.tolerances(result, entry)
    facts = [('good', for_a_time.good_for(entry, allowed, unit))]
    learnt = '' if plant is None else for_a_time.learning(plant, entry, allowed, unit)
    return [*facts, ('slow offset', learnt)] if learnt else facts
