"""What a design says of whose fault it is, in words and marks: for the terminal and the page."""

from __future__ import annotations

from collections.abc import Sequence

from vsensor_ros.designer.location import Location
from vsensor_ros.observers import Isolability, NONE, STRENGTHS, STRONG, WEAK

MARKS = {STRONG: 'yes', WEAK: 'onset', NONE: 'no'}
KEY = ('yes: a constant fault, too; onset: while it is new, a constant one fades; no: the plant '
       'allows none')
SEEN = 'seen'  # head of the column that tells no fault from another


def summary(found: Isolability) -> str:
    """Return how much is told of what the plant allows."""
    singles = [d for d in found.plant if len(d.others) == 1]
    allowed = [d for d in singles if d.strength != NONE]
    done = [d for d in allowed if found.by_residuals(d.sensor, d.others) == d.strength]
    count = len(found.residuals) - len(found.filters)
    of_filters = f' and {len(found.filters)} dedicated filter{"s" * (len(found.filters) > 1)}'
    return (f'{count} residual{"s" * (count != 1)} of virtual sensors'
            f'{of_filters if found.filters else ""} tell {len(done)} of the {len(allowed)} '
            f'ordered pairs that the plant allows, of {len(singles)}')


def table(found: Isolability, sensors: Sequence[str]) -> list[list[tuple[str, str]]]:
    """
    Return for each sensor the marks of its row: seen, then told from each sensor.

    Each is (how well: 'strong', 'weak', 'none' or '' for itself, the mark). What the plant allows
    and the residuals do not is in brackets.
    """
    allowed = {(d.sensor, d.others): d.strength for d in found.plant}
    rows = []
    for s in sensors:
        row = []
        for others in ((), *((i,) for i in sensors)):
            best = allowed.get((s, others), NONE)
            has = found.by_residuals(s, others)
            mark = MARKS[has] if STRENGTHS.index(has) >= STRENGTHS.index(best) else (
                f'({MARKS[best]})')
            row.append(('', '-') if s in others else (has, mark))
        rows.append(row)
    return rows


def gained(location: Location) -> str:
    """Say whose faults one more sensor would let you see, or tell from which; '': of none."""
    seen = [s for others, s in location.isolable if not others]
    told = [f'{s} from {others[0]}' for others, s in location.isolable
            if others and s not in seen]
    parts = [*([f'see faults of {", ".join(seen)}'] if seen else []),
             *([f'tell {", ".join(told)}'] if told else [])]
    return f'would let you {" and ".join(parts)}' if parts else ''
