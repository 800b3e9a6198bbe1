"""
The verdict of a replay as one HTML file, with pictures of worst, median and best windows.

No script and nothing from a network. What comes from files is escaped by the template.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.recordings.judgement import Judgement, Window
from vsensor_ros.recordings.replay_text import lines_of, outcome_line, title
from vsensor_ros.recordings.requirement import Outcome
from vsensor_ros.recordings.trials import Trials
from vsensor_ros.whole_file import write_whole

MOST_PICTURES = 60
LABELS = ('worst', 'median', 'best')

TEMPLATE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Replay of {{ heading }}</title><style>
body { font: 15px/1.45 sans-serif; max-width: 72em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; } td, th { padding: .2em .7em; text-align: right; }
th { border-bottom: 1px solid #888; } td:first-child, th:first-child { text-align: left; }
.beaten, .FAIL { color: #b00020; } .PASS { color: #1b6e20; } pre { white-space: pre-wrap; }
figure { display: inline-block; margin: 0; width: 32%; } svg { width: 100%; height: auto; }
</style></head><body>
<h1>Replay of {{ heading }}</h1>
<p>Windows of {{ windows.length }} s every {{ windows.every }} s. The simple peers were fitted on
what lies between them. Errors are in the unit of the channel.</p>
{% if outcomes %}<h2 class="{{ verdict }}">{{ verdict }}</h2>
<pre>{% for line, passed in outcomes -%}
<span class="{{ 'PASS' if passed else 'FAIL' }}">{{ line }}</span>
{% endfor %}</pre>{% endif %}
<table><tr><th>channel, what was lost</th><th>served</th><th>rmse</th><th>90 % at the end</th>
<th>within 2 deviations</th><th>hold</th><th>regression</th><th>ARX</th></tr>
{% for j in judgements %}
<tr{% if j.judgement.beaten or not j.judgement.served %} class="beaten"{% endif %}>
<td><a href="#v{{ loop.index }}">{{ j.title }}</a></td>
{% for cell in j.cells %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table>
<p class="beaten">Red: a simple peer is better, or nothing went out.</p>
{% for j in judgements %}<h2 id="v{{ loop.index }}">{{ j.title }}</h2>
{% for label, picture in j.pictures -%}
<figure>{{ picture | safe }}<figcaption>{{ label }}</figcaption></figure>
{% endfor %}<pre>{% for line in j.lines %}{{ line }}
{% endfor %}</pre>
{% endfor %}</body></html>
"""


def need_libraries(path: Path) -> None:
    """Raise BadInput unless a page can be made."""
    try:
        import jinja2
        import matplotlib
    except ImportError as error:
        raise BadInput(path, '--report', f'{error.name} is not installed',
                       "pip install '.[recordings]'") from None
    assert jinja2 and matplotlib


def write_page(path: Path, heading: str, judgements: Sequence[Judgement],
               outcomes: Sequence[Outcome], trials: Trials) -> None:
    """Write the page, whole or not at all; raises BadInput."""
    from jinja2 import Environment, StrictUndefined

    room = MOST_PICTURES
    told = []
    for j in judgements:
        shown = j.shown[:room]
        room -= len(shown)
        told.append({'judgement': j, 'title': title(j), 'lines': lines_of(j), 'cells': _cells(j),
                     'pictures': [(f'{label}: {w.recording} at {w.start:g} s', _picture(w, j))
                                  for label, w in zip(LABELS, shown)]})
    template = Environment(autoescape=True, undefined=StrictUndefined).from_string(TEMPLATE)
    text = template.render(
        heading=heading, windows=trials.windows, judgements=told,
        outcomes=[(outcome_line(o), o.passed) for o in outcomes],
        verdict='PASS' if all(o.passed for o in outcomes) else 'FAIL')
    try:
        write_whole(path, text)
    except (OSError, ValueError) as error:
        raise BadInput(path, '--report', f'cannot be written ({reason(error)})',
                       'name a file in a folder that exists and is writable') from error


def _cells(j: Judgement) -> list[str]:
    return [f'{100 * j.served:.3g} %', *('-' if np.isnan(v) else f'{v:.3g}' for v in (
        j.rmse, j.p90)), '-' if np.isnan(j.coverage) else f'{100 * j.coverage:.3g} %',
        *('-' if np.isnan(v) else f'{v:.3g}' for v in (j.hold, j.regression, j.arx))]


def _picture(window: Window, j: Judgement) -> str:
    """Return a picture of what was said and what was true: SVG, its texts escaped."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.2))
    FigureCanvasSVG(figure)
    axes = figure.add_axes((0.17, 0.15, 0.8, 0.82))
    times = window.times - window.start
    axes.fill_between(times, window.values - 2 * window.deviations,
                      window.values + 2 * window.deviations, color='tab:blue', alpha=0.2, lw=0,
                      label='2 stated deviations')
    for name, colour in (('hold', '0.6'), ('regression', 'tab:green'), ('arx', 'tab:orange')):
        axes.plot(times, window.peers[name], color=colour, lw=0.8, label=name)
    axes.plot(times, window.truth, color='black', lw=1.2, label='recorded')
    axes.plot(times, window.values, color='tab:blue', lw=1.2, label='virtual sensor')
    shown = np.concatenate([window.truth, window.values[np.isfinite(window.values)]])
    low, high = float(shown.min()), float(shown.max())
    margin = 0.25 * (high - low) or 1.0
    axes.set_ylim(low - margin, high + margin)  # a peer that ran away does not flatten the rest
    axes.set_xlabel('s after the loss')
    axes.set_ylabel(j.unit or 'value', parse_math=False)
    axes.legend(fontsize=6, ncols=2)
    file = StringIO()
    figure.savefig(file, format='svg', metadata={'Date': None})
    text = file.getvalue()
    return text[text.index('<svg'):]
