"""designer PLANT -o DESIGN: say for each sensor whether it can be replaced, and write the file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import io
import os
import sys

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.designer import design
from vsensor_ros.plant import load_plant
from vsensor_ros.virtual_sensor import Design, Refusal, VirtualSensor


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0, or 2 with one line on stderr when the input is bad."""
    parser = argparse.ArgumentParser(
        prog='designer', description='Design a virtual sensor for every sensor of a plant.')
    parser.add_argument('plant', metavar='PLANT', help='plant file (YAML)')
    parser.add_argument('-o', '--output', metavar='DESIGN', required=True,
                        help='design file to write (JSON)')
    parser.add_argument('--fault-set', metavar='SENSORS', action='append',
                        help='sensors that fail together, with commas between; may be given '
                        'several times (default: every single sensor)')
    options = parser.parse_args(arguments)
    try:
        _check_files(options.plant, options.output)
        result = design(load_plant(options.plant), _fault_sets(options.fault_set))
        result.save(options.output)
        _say(f'{report(result)}\n{len(result.virtual_sensors)} of {len(result.entries)} can be '
             f'replaced; written to {options.output}')
    except BadInput as error:
        print(f'designer: {error}', file=sys.stderr)
        return 2
    return 0


def _check_files(plant: str, output: str) -> None:
    for what, path in (('PLANT', plant), ('-o', output)):
        if not path:
            raise BadInput(what, '', 'is empty', 'name a file')
    try:
        same = os.path.samefile(plant, output)
    except (OSError, ValueError):  # not both are there; what is missing is said when it is opened
        return
    if same:
        raise BadInput('-o', '', f'{output} is the plant file itself', 'name another file')


def _fault_sets(texts: list[str] | None) -> list[list[str]] | None:
    if texts is None:
        return None
    sets = [[name.strip() for name in text.split(',')] for text in texts]
    if not all(name for names in sets for name in names):
        raise BadInput('--fault-set', '', 'a name is empty', 'write it as --fault-set y1,y2')
    return sets


def _say(text: str) -> None:
    """Print to a stdout that may be full, closed or ASCII only; BadInput when it cannot."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors='backslashreplace')  # a unit may be °C
    try:
        print(text, flush=True)
    except OSError as error:
        # what is left in the buffer must not fail once more when Python ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise BadInput('stdout', '', f'cannot be written ({reason(error)})',
                       'the design file is complete') from error


def report(result: Design) -> str:
    """Return the table a person reads: one block for each fault set and channel."""
    time = ('continuous time' if result.sample_time is None
            else f'sample time {result.sample_time:g} s')
    lines = [f'Plant {result.plant_name}, {time}, {len(result.states)} states', '']
    several = any(len(fault_set) > 1 for fault_set in result.fault_sets)
    for (fault_set, channel), entry in result.entries.items():
        title = f'{channel} [{result.units[channel]}]' if result.units.get(channel) else channel
        if several:
            title += f' when {" and ".join(fault_set)} failed' if len(fault_set) > 1 else (
                ' when it alone failed')
        if isinstance(entry, Refusal):
            lines += [f'{title}: cannot be replaced', f'    {entry.reason}', '']
        else:
            lines += [f'{title}: can be replaced', *_facts(entry), '']
    return '\n'.join(lines).rstrip() + '\n'


def _facts(entry: VirtualSensor) -> list[str]:
    driving = [name for name, column in zip(entry.inputs, entry.B.T) if column.any()]
    terms = [entry.terms[i].name for i in entry.active]
    facts = {
        'order': f'{entry.order} ({entry.method})',
        'reads': ', '.join([*entry.reads, *driving]) or 'nothing: it is a constant',
        'eigenvalues of N': ', '.join(_complex(v) for v in entry.eigenvalues) or 'none',
        'noise gain': f'{entry.noise_gain:.3g}',
    }
    if terms:
        facts['nonlinear terms'] = ', '.join(terms)
    return [f'    {name:17} {value}' for name, value in facts.items()]


def _complex(value: complex) -> str:
    real = f'{value.real:.4g}'
    return real if np.isclose(value.imag, 0.0) else f'{real} {value.imag:+.4g}i'


if __name__ == '__main__':
    sys.exit(main())
