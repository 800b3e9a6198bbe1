"""designer PLANT -o DESIGN: say for each sensor whether it can be replaced, and write the file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import sys

import numpy as np

from vsensor_ros.bad_input import BadInput
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
    parser.add_argument('--fault-set', metavar='SENSOR', nargs='+', action='append',
                        help='sensors that fail together; may be given several times '
                        '(default: every single sensor)')
    options = parser.parse_args(arguments)
    try:
        result = design(load_plant(options.plant), options.fault_set)
        result.save(options.output)
    except BadInput as error:
        print(f'designer: {error}', file=sys.stderr)
        return 2
    print(report(result))
    print(f'{len(result.virtual_sensors)} of {len(result.entries)} can be replaced; '
          f'written to {options.output}')
    return 0


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
