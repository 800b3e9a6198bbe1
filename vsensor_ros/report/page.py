"""
The report: one HTML file that says all a design promises, readable on its own and on paper.

No script and nothing from a network. Every text of the plant is escaped: names and units come
from a file that somebody else may have written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
import os
from pathlib import Path

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.control import ClosedLoop
from vsensor_ros.designer.location import Location
from vsensor_ros.functions.expression import to_words
from vsensor_ros.observers import Design, Entry, Refusal, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.plant.plant import measures_node
from vsensor_ros.report import (
    design_text,
    fault_size_text,
    for_a_time,
    isolability_text,
    loop_text,
    report_simulation,
)
from vsensor_ros.report.loop_picture import poles_caption, poles_picture
from vsensor_ros.report.picture import need_matplotlib, picture
from vsensor_ros.text_file import looked_in
from vsensor_ros.whole_file import write_whole

MOST_PICTURES = 12
GRID = 30  # sensors of a table of pairs
MOST_PLACES = 40
EIGENVALUES = 40
RISES, STAYS, FAR = 1.5, 0.5, 1e3  # an error, from its start and of its most; of its truth
PAGES = ('.html', '.htm')

STYLE = """
body { font: 15px/1.5 system-ui, 'DejaVu Sans', sans-serif; color: #1b1b1b; background: #fff;
  max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; margin-bottom: 0; }
h2 { font-size: 1.3rem; border-bottom: 2px solid #1f5fbf; margin-top: 2.5rem; }
h3 { font-size: 1.1rem; margin: 2rem 0 .3rem; }
table { border-collapse: collapse; margin: .6rem 0; font-size: .92em; }
th, td { text-align: left; padding: .15rem .7rem .15rem 0; vertical-align: top;
  border-bottom: 1px solid #e2e2e2; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
table.facts th { font-weight: normal; color: #666; white-space: nowrap; }
table.pairs { font-size: .75em; }
table.pairs td { text-align: center; padding: .05rem .2rem; border: 1px solid #ddd; }
table.pairs th { padding: .05rem .2rem; border: 0; font-weight: normal; }
table.pairs tr:last-child th { writing-mode: vertical-rl; }
.yes { background: #d9f0dc; } .bounded { background: #fdf0c8; }
.temporary, .filtered { background: #dfe9fb; } .no { background: #f8d7d3; }
.small, figcaption { color: #555; font-size: .88em; }
tr.taken td { font-weight: bold; }
.doubt { background: #fdf0c8; padding: .2rem .5rem; }
h2, h3 { break-after: avoid; }
tr { break-inside: avoid; }
figure { margin: .6rem 0; break-inside: avoid; }
svg { max-width: 100%; height: auto; }
code { font-family: 'DejaVu Sans Mono', monospace; font-size: .92em; }
a { color: #1f5fbf; text-decoration: none; }
@media print { body { max-width: none; margin: 0; font-size: 10pt; }
  .yes, .bounded, .filtered, .temporary, .no {
    print-color-adjust: exact; -webkit-print-color-adjust: exact; } }
"""


def check_target(path: str | Path) -> None:
    """Raise BadInput when no report can be made there: wrong place, or matplotlib is missing."""
    if str(path).endswith(PAGES) and os.path.isdir(path):
        raise BadInput(path, 'report', 'is a folder', 'name a file, or a folder without .html')
    if not str(path).endswith(PAGES) and os.path.exists(path) and not os.path.isdir(path):
        raise BadInput(path, 'report', 'is a file that is not named .html',
                       'name a file out.html, or a folder')
    try:
        need_matplotlib()
    except ModuleNotFoundError as missing:
        raise BadInput('report', '', f'{missing.name} is not installed',
                       'pip install matplotlib, or leave the report out') from None


def write_report(path: str | Path, plant: Plant, design: Design,
                 locations: Sequence[Location] | None = None,
                 progress: Callable[[int, int, str], None] | None = None,
                 advice: Sequence[str] = (), loop: ClosedLoop | None = None) -> Path:
    """
    Write the report of a plant's design to a file named .html, or as index.html into a folder.

    ``advice``: what is to be minded, besides the plant's remarks. The old file stays whole until
    the new one is complete. Returns the file's path; raises BadInput when it cannot be written, or
    when matplotlib is missing.
    """
    check_target(path)
    target = Path(path)
    text = page(plant, design, locations, progress, advice, loop)
    try:
        if not str(path).endswith(PAGES):
            target.mkdir(parents=True, exist_ok=True)
            target = target / 'index.html'
        write_whole(target, text)
    except (OSError, ValueError) as error:
        raise BadInput(path, 'report', f'cannot be written ({reason(error)}){looked_in(path)}',
                       'name a place that is writable; the design file is complete') from error
    return target


def page(plant: Plant, design: Design, locations: Sequence[Location] | None = None,
         progress: Callable[[int, int, str], None] | None = None,
         advice: Sequence[str] = (), loop: ClosedLoop | None = None) -> str:
    """Return the report as HTML."""
    name = escape(design.plant_name)
    parts = [*_headlines(loop), _summary(design), _minded((*plant.remarks, *advice)),
             _plant(plant), _losses(design), _overview(design), _isolability(design),
             _sizes(design), _loop(plant, loop), _places(plant, design, locations),
             _entries(plant, design, progress), _terms(plant, design), _reading()]
    return ('<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
            'style-src \'unsafe-inline\'">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f'<title>Virtual sensors of {name}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n'
            f'<h1>Virtual sensors of {name}</h1>\n' + '\n'.join(p for p in parts if p)
            + '\n</body>\n</html>\n')


def _table(rows: Iterable[Sequence[str]], head: Sequence[str] = (), figures: Sequence[int] = (),
           classes: Sequence[str] | None = None) -> str:
    """Return a table of cells that are HTML already; ``figures``: columns to align right."""
    def line(cells: Sequence[str], tag: str, row_class: str = '') -> str:
        inner = ''.join(f'<{tag}{" class=n" if i in figures else ""}>{cell}</{tag}>'
                        for i, cell in enumerate(cells))
        return f'<tr{f" class={row_class}" if row_class else ""}>{inner}</tr>'
    body = [line(row, 'td', classes[i] if classes else '') for i, row in enumerate(rows)]
    top = f'<thead>{line(head, "th")}</thead>' if head else ''
    return f'<table>{top}<tbody>{"".join(body)}</tbody></table>'


def _facts(facts: Iterable[tuple[str, str]]) -> str:
    rows = ''.join(f'<tr><th>{name}</th><td>{value}</td></tr>' for name, value in facts if value)
    return f'<table class=facts>{rows}</table>'


def _summary(design: Design) -> str:
    total, able = len(design.entries), len(design.virtual_sensors)
    said = f'<strong>{able} of {total}</strong> can be replaced'
    for grade, how in (('bounded', 'within a bound'), ('temporary', 'for a time'),
                       ('filtered', 'without proof')):
        if count := sum(v.grade == grade for v in design.virtual_sensors):
            said += f', {count} of them {how} only'
    wary = sum(design_text.certified(v) in ('not certified', 'NOT certified')
               for v in design.virtual_sensors)
    if wary:
        said += f'; the stability of {wary} is not certified'
    unsure = sum(bool(design_text.doubts(e)) for e in design.entries.values())
    if unsure:
        said += f'; {unsure} rest on ambiguous numerical decisions'
    return (f'<p>{said}.</p><p class=small>A virtual sensor computes what a failed sensor would '
            'say from the sensors and commands that are left.</p>')


def _minded(lines: Sequence[str]) -> str:
    items = ''.join(f'<li>{escape(line)}</li>' for line in lines)
    return f'<h2>Mind</h2><ul>{items}</ul>' if items else ''
def _headlines(loop: ClosedLoop | None) -> list[str]:
    lines = [] if loop is None else loop_text.headlines(loop)
    held = loop is not None and all(
        case.holds or case.verdict == 'not replaced' for case in loop.cases)
    return [f'<p class={"small" if held else "doubt"}>{escape(line)}.</p>' for line in lines]


def _loop(plant: Plant, loop: ClosedLoop | None) -> str:
    if loop is None:
        return ''
    rows = [tuple(map(escape, loop_text.row(loop, case, plant))) for case in loop.cases]
    colours = {'stable': 'yes', 'for a time': 'temporary', 'stays': 'bounded'}
    parts = [f'<h2>In the loop</h2><p>With {escape(loop_text.closed_how(loop))}.</p>', _table(
        rows, ('replaced', '', 'grows by [1/s]', 'at the worst corner [1/s]', 'unstable corners',
               'sensitivity peak', f'noise of {escape(", ".join(loop.controller.writes))}'),
        (2, 3, 4, 5, 6), ['no' if case.unstable_corners else colours.get(case.verdict, 'no')
                          for case in loop.cases])]
    parts += [f'<p class=small>{escape(note)}</p>' for note in loop_text.notes(loop)]
    drawn = [case for case in loop.cases if len(case.poles)]
    if len(drawn) > MOST_PICTURES:
        drawn = sorted(drawn, key=lambda case: case.holds)[:MOST_PICTURES]
        parts.append(f'<p>Poles are drawn of {MOST_PICTURES} of {len(loop.cases)} loops, those '
                     'that do not hold first.</p>')
    for i, case in enumerate(drawn):
        said = _facts((name, escape(value))
                      for name, value in loop_text.facts(loop, case, plant, EIGENVALUES))
        parts.append(f'<h3>{escape(loop_text.title(case))}</h3>{said}<figure>'
                     f'{poles_picture(loop, case, f"loop{i}")}<figcaption>'
                     f'{escape(poles_caption(loop, case))}</figcaption></figure>')
    return '\n'.join(parts)


def _unit(plant: Plant, name: str) -> str:
    unit = plant.units.get(name, '')
    return f' [{escape(unit)}]' if unit else ''


def _plant(plant: Plant) -> str:
    time = ('continuous time' if plant.sample_time is None
            else f'discrete time, one step each {plant.sample_time:g} s')

    def named(names: Sequence[str]) -> str:
        return ', '.join(f'<code>{escape(n)}</code>{_unit(plant, n)}' for n in names) or 'none'

    measures = []
    for i, sensor in enumerate(plant.sensors):
        text = to_words(measures_node(plant, i))
        sigma = plant.noise[i]
        measures.append((f'<code>{escape(sensor)}</code>{_unit(plant, sensor)}',
                         f'<code>{escape(text)}</code>',
                         'not given' if np.isnan(sigma) else design_text.number(sigma)))
    acts = []
    for j, name in enumerate(plant.disturbances):
        on = [*(s for s, d in zip(plant.states, plant.D[:, j]) if d),
              *(s for s, d in zip(plant.sensors, plant.Cd[:, j]) if d)]
        acts.append(f'<code>{escape(name)}</code>{_unit(plant, name)} on '
                    f'{", ".join(map(escape, on)) or "nothing"}')
    facts = [('time', time), (f'{len(plant.states)} states', named(plant.states)),
             ('commands', named(plant.inputs)),
             ('unknown inputs', '; '.join(acts) or 'none'),
             ('nonlinear terms', ', '.join(
                 f'<code>{escape(term.short)}</code>' for term in plant.terms) or 'none')]
    return ('<h2>The plant</h2>' + _facts(facts) + _table(
        measures, ('sensor', 'measures', 'noise (standard deviation)'), (2,)))


def _terms(plant: Plant, design: Design) -> str:
    rows = [(escape(term.short), f'<code>{escape(term.name)}</code>')
            for term in design_text.long_terms(design, plant)]
    return '<h2>Terms</h2>' + _table(rows) if rows else ''


def _losses(design: Design) -> str:
    rows = [(size, '<br>'.join(map(escape, sentences)))
            for size, sentences in design_text.loss_lines(design)]
    if not rows:
        return ''
    return ('<h2>Which sensors this plant can afford to lose</h2>'
            + _table(rows, ('at the same time', 'sets of sensors')) + _pairs(design))


def _pairs(design: Design) -> str:
    pairs = design_text.losses(design).get(2, {})
    names = design.sensors
    if len(names) > GRID or len(pairs) < 3 or len(pairs) < len(names) * (len(names) - 1) // 2:
        return ''
    single = design_text.losses(design).get(1, {})
    marks = {'yes': 'yes', 'bounded': 'bound', 'temporary': 'time', 'no': 'no',
             'filtered': 'filter'}
    rows = []
    for i, a in enumerate(names):
        cells = []
        for b in names[:i + 1]:
            said = single.get((a,)) if a == b else pairs.get((b, a))
            cells.append(f'<td class={said}>{marks[said]}</td>' if said else '<td></td>')
        rows.append(f'<tr><th>{escape(a)}</th>{"".join(cells)}</tr>')
    head = ''.join(f'<th>{escape(n)}</th>' for n in names)
    return ('<p class=small>Pairs; on the diagonal each sensor alone:</p><table class=pairs>'
            f'{"".join(rows)}<tr><th></th>{head}</tr></table>')


def _anchor(index: int) -> str:
    return f'e{index + 1}'


def _overview(design: Design) -> str:
    rows, classes = [], []
    for i, ((fault_set, channel), entry) in enumerate(design.entries.items()):
        unit = design.units.get(channel, '')
        first = (f'<a href="#{_anchor(i)}">{escape(design_text.joined(fault_set))}</a>',
                 escape(channel))
        if isinstance(entry, Refusal):
            rows.append((*first, design_text.state_of(entry), '', '', '', ''))
            classes.append('no')
            continue
        n = entry.noise
        rows.append((*first, str(entry.order),
                     escape(design_text.number(n.error, unit)) if n else '',
                     f'{n.ratio:.2f}' if n and np.isfinite(n.floor) else '',
                     design_text.rate(entry.decay, entry), escape(design_text.certified(entry))))
        classes.append(entry.grade if entry.grade != 'exact' else '')
    return ('<h2>All at a glance</h2>' + _table(
        rows, ('failed', 'replaced', 'order', 'noise error', 'x floor', 'decay [1/s]',
               'stability proved'), (3, 4, 5), classes))


def _isolability(design: Design) -> str:
    found, names = design.isolability, design.sensors
    if found is None:
        return ''
    parts = ['<h2>Whose fault it is</h2>', f'<p>{escape(isolability_text.summary(found))}.</p>']
    if len(names) <= GRID:
        marked = {'strong': 'yes', 'weak': 'temporary', 'none': 'no', '': ''}
        rows = ''.join(f'<tr><th>{escape(s)}</th>' + ''.join(
            f'<td class="{marked[how]}">{mark}</td>' for how, mark in row) + '</tr>'
            for s, row in zip(names, isolability_text.table(found, names)))
        head = ''.join(f'<th>{escape(n)}</th>' for n in (isolability_text.SEEN, *names))
        parts.append('<p class=small>Can a fault of the row be seen, and told from one of the '
                     f'column? {escape(isolability_text.KEY)}.</p><table class=pairs>{rows}'
                     f'<tr><th></th>{head}</tr></table>')
    if found.gaps:
        parts.append(f'<ul>{"".join(f"<li>{escape(gap)}</li>" for gap in found.gaps)}</ul>')
    rows_ = [(escape(r.name), ', '.join(
        f'{escape(s)} ({"?" if gain is None else design_text.number(gain)})'
        for s, gain in zip(r.support, r.gains)),
        escape(design_text.number(r.noise, design.units.get(r.channel, ''))),
        escape(design_text.number(r.threshold, design.units.get(r.channel, ''))))
        for r in found.residuals]
    return ''.join(parts) + _table(
        rows_, ('residual', 'feels (what a constant fault of 1 makes of it)', 'noise',
                'threshold to begin with'), (2, 3))


def _sizes(design: Design) -> str:
    if design.fault_sizes is None:
        return ''
    rows = [(escape(name), escape(taken), '<br>'.join(map(escape, others)))
            for name, taken, others in fault_size_text.rows(design.fault_sizes, design.units)]
    return (f'<h2>{fault_size_text.HEAD}</h2><p>If it is the only one.</p>' + _table(
        rows, ('fault of', 'is told by', 'what else there is, for the same response')))


def _places(plant: Plant, design: Design, locations: Sequence[Location] | None) -> str:
    head = '<h2>Where one more sensor would help</h2>'
    if locations is None:
        if not design.refusals:
            return ''
        return head + '<p class=small>Not looked at: ask with <code>designer --locate</code>.</p>'
    if not locations:
        return head + ('<p>Every state is measured already: only a second sensor of the same '
                       'would help.</p>')
    rows = [(f'<code>{escape(place.name)}</code>{_unit(plant, place.name)}',
             escape('; '.join(filter(None, (design_text.gained(place),
                                            isolability_text.gained(place))))),
             str(len(place.raised)),
             f'{place.rank} of {len(plant.states)}')
            for place in locations[:MOST_PLACES]]
    more = len(locations) - MOST_PLACES
    return head + _table(rows, ('one more sensor of', '', 'tells something new in .. fault sets',
                                'rank of all sensors'), (2, 3)) + (
        f'<p class=small>and {more} more places that are no better.</p>' if more > 0 else '')


def _entries(plant: Plant, design: Design,
             progress: Callable[[int, int, str], None] | None) -> str:
    sensors = [v for v in design.virtual_sensors
               if isinstance(v, VirtualSensor) and len(v.Cv) == 1 and v.grade != 'temporary']
    drawn = {id(v): i for i, v in enumerate(sensors[:MOST_PICTURES])}
    parts = ['<h2>One by one</h2>']
    if len(sensors) > MOST_PICTURES:
        parts.append(f'<p>Pictures are drawn for the first {MOST_PICTURES} of {len(sensors)} '
                     'virtual sensors only.</p>')
    for i, ((fault_set, channel), entry) in enumerate(design.entries.items()):
        heading = (f'<h3>{escape(design_text.title(design, fault_set, channel))}: '
                   f'{escape(design_text.state_of(entry) + design_text.left_out(entry))}</h3>')
        if isinstance(entry, Refusal):
            body = f'<p>{escape(entry.reason)}.</p>'
            if entry.alternative:
                body += f'<p>Instead: {escape(entry.alternative)}</p>'
        else:
            body = _sensor(plant, design, entry)
            if isinstance(entry, VirtualSensor) and id(entry) in drawn:
                if progress is not None:
                    progress(drawn[id(entry)], len(drawn), f'picture of {channel}')
                body += _figure(plant, design, entry, _anchor(i))
        doubts = ''.join(f'<p class=doubt>In doubt: {escape(d)}</p>'
                         for d in design_text.doubts(entry))
        parts.append(f'<section id={_anchor(i)}>{heading}{doubts}{body}</section>')
    return '\n'.join(parts)


def _sensor(plant: Plant, design: Design, entry: Entry) -> str:
    unit = design.units.get(entry.channel, '')
    if not isinstance(entry, VirtualSensor):
        return _facts([(name, escape(value)) for name, value in design_text.facts(
            entry, unit, design.units)])
    temporary = entry.grade == 'temporary'
    allowed = for_a_time.tolerances(design, entry) if temporary else []
    facts = [
        ('order', escape(design_text.order(entry))),
        ('reads', escape(design_text.reads(entry))),
        ('good', escape(for_a_time.good_for(entry, allowed, unit)) if temporary else ''),
        ('slow offset', escape(for_a_time.learning(plant, entry, allowed, unit))),
        ('noise error', '' if temporary else escape(design_text.noise(entry, unit))),
        ('decay', escape(design_text.decay(entry))),
        ('eigenvalues of N', escape(design_text.eigenvalues(entry, EIGENVALUES))),
        ('stability', '<br>'.join(map(escape, design_text.certificate(entry, design.units)))),
        ('unknown inputs', escape(design_text.disturbance(entry, unit))
         if plant.disturbances or entry.grade != 'exact' else ''),
        ('noise gain', '' if temporary else f'{design_text.number(entry.noise_gain)}: no error of '
                       'the readings is amplified by more, at any frequency'),
        ('nonlinear terms', escape(', '.join(entry.terms[i].short for i in entry.active))),
        ('found as', escape(entry.method)),
        ('alternatives', escape(entry.why)),
    ]
    text = _facts(facts)
    if temporary:
        text += '<p class=small>One standard deviation of it after the last good reading:</p>' \
            + _table([tuple(map(escape, row)) for row in
                                    for_a_time.growth(entry, unit)], ('after', ''), (0, 1))
    if entry.ladder:
        text += '<p class=small>The ladder of orders:</p>' + _table(
            [(str(r.order), escape(design_text.number(r.noise, unit)),
              design_text.number(r.noise_gain),
              design_text.rate(r.decay, entry),
              escape(r.method) + (', taken' if taken else ''))
             for r, taken in design_text.rungs(entry)],
            ('order', 'noise error', 'noise gain', 'decay [1/s]', 'found as'), (0, 1, 2, 3),
            ['taken' if taken else '' for _, taken in design_text.rungs(entry)])
    if entry.proof is not None:
        text += '<p class=small>What is proved of each order, with the relative singular values ' \
                'on both sides of the decisions:</p>' + _table(
            [(str(s.order), escape(s.verdict), escape(s.why), str(s.freedom),
              f'{s.gap[0]:.0e}', f'{s.gap[1]:.0e}') for s in entry.proof.steps],
            ('order', '', 'why', 'freedom', 'taken for 0', 'taken for not 0'), (0, 3, 4, 5))
    return text


def _figure(plant: Plant, design: Design, entry: VirtualSensor, salt: str) -> str:
    """Return the picture of one virtual sensor at work, with what it shows in figures."""
    unit = design.units.get(entry.channel, '')
    said: list[str] = []
    start = pushed = None
    if not entry.order:
        said.append('It has no state that could start wrong.')
    else:
        try:
            start = report_simulation.from_wrong_start(plant, design, entry)
            said.append(_from_wrong_start(start, unit))
        except report_simulation.NotRun as why:
            said.append(f'The run from a wrong start is not shown: {why}.')
    if plant.disturbances:
        try:
            pushed = report_simulation.disturbed(plant, design, entry)
            sizes = ', '.join(
                f'{name} {design_text.number(size, plant.units.get(name, ""))}'
                for name, size in zip(plant.disturbances, np.abs(pushed.rho).max(axis=0)))
            moved = float(np.abs(pushed.truth - pushed.still).max())
            if moved > 1e-9 * np.abs(pushed.truth).max():
                moves = f'move the truth by up to {design_text.number(moved, unit)}'
            else:
                moves = 'do not move the truth'
            said.append(f'Unknown inputs ({sizes}) {moves}, and the error is at most '
                        f'{design_text.number(float(np.nanmax(np.abs(pushed.error))), unit)}.')
        except report_simulation.NotRun as why:
            said.append(f'The run with unknown inputs is not shown: {why}.')
    said = [*_unstable((start, pushed)), *said]
    drawing = (picture(entry, unit, start, pushed, salt)
               if start is not None or pushed is not None else '')
    return f'<figure>{drawing}<figcaption>{escape(" ".join(said))}</figcaption></figure>'


def _from_wrong_start(run: report_simulation.SimulatedRun, unit: str) -> str:
    first, last = np.abs(run.error[[0, -1]])
    most, reach = float(np.nanmax(np.abs(run.error))), float(np.abs(run.truth).max())
    moved = float(np.abs(run.truth - run.truth[0]).max())
    goes = (f'goes from {design_text.number(first, unit)} to {design_text.number(last, unit)} in'
            if most <= RISES * first else f'rises to {design_text.number(most, unit)} and is '
            f'{design_text.number(last, unit)} after')
    text = f'From a wrong start the error {goes} {design_text.seconds(run.time[-1])}'
    if run.runs_away or moved > FAR * max(most, abs(run.truth[0])):
        text += f', while the truth runs away to {design_text.number(reach, unit)}'
    elif last > STAYS * most:
        text += ': from there it does not find back, the start lies outside what is certified'
    return f'{text}.'


def _unstable(runs: Iterable[report_simulation.SimulatedRun | None]) -> list[str]:
    """Say what was done with a plant that does not stay where it is by itself."""
    shown = [run for run in runs if run is not None]
    said = []
    if any(run.held for run in shown):
        said.append('The plant is unstable by itself. Here a controller that knows its true state '
                    'holds it; the virtual sensor knows only readings and commands.')
    away = next((run for run in shown if run.runs_away), None)
    if away is not None:
        said.append('The plant is unstable and its commands do not hold it: only the error is '
                    'drawn. It may grow with the readings, of which there is one each '
                    f'{design_text.number(away.time[1], "s")}.')
    return said


def _reading() -> str:
    return '<h2>How to read this</h2>' + _facts([
        ('order', 'number of states of the virtual sensor; 0: a fixed combination of readings'),
        ('noise error', 'standard deviation of the error when all else has died out, from the '
         'noise of sensors and process; assumed where the plant gives no figures'),
        ('floor', 'the same for a Kalman filter on the same healthy sensors: nothing is quieter'),
        ('decay', 'rate at which a wrong start is forgotten, by the eigenvalues of N: those of '
         "the observer's error, not of a loop that a controller closes over it"),
        ('stability', 'certified: proved for the nonlinear terms as they are; not certified: only '
         'the linear part has been judged'),
        ('unknown inputs', 'what acts on the plant and nobody measures; an exact virtual sensor '
         'does not feel them, a bounded one does, by the gain stated'),
        ('for a time', 'an error that is there when the channel is lost stays or grows: it starts '
         'from the last good readings, and is good until noise and drift have added up'),
        ('in doubt', 'a decision on a rank so close that a small error of the model turns it'),
        ('pictures', "simulated without sensor noise; the replacer's own arithmetic beside the "
         'true plant, which is held by its commands where it is unstable by itself'),
    ])
