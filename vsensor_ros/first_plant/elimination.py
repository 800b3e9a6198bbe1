"""Equations M a = b of a mechanism, solved for a in definitions: M = L D L' (Cholesky)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def solved(mass: Mapping[tuple[int, int], str], right: Sequence[str], end: str = '',
           ) -> tuple[dict[str, str], list[str]]:
    """
    Return definitions, and the names of the accelerations.

    mass: names or numbers of what stands in M at (i, j), j <= i, where it is not 0; right: b, by
    name. The definitions are `d1`, `l21`, `y1`, `acceleration1` and the like, counted from 1, with
    an end behind.
    """
    d, x, y = ([f'{what}{i + 1}{end}' for i in range(len(right))] for what in (
        'd', 'acceleration', 'y'))

    n, made = len(right), dict[str, str]()
    times: dict[tuple[int, int], str] = {}  # l_ik d_k, by name
    factors = {(i, k): f'l{i + 1}{k + 1}{end}' for i in range(n) for k in range(i)}
    for i in range(n):
        for j in range(i + 1):
            terms = [mass[i, j]] if (i, j) in mass else []
            terms += [f'-{times[i, k]}*{factors[j, k]}' for k in range(j)
                      if (i, k) in times and (j, k) in times]
            if terms and i == j:
                made[d[i]] = _sum(terms)
            elif terms:
                times[i, j] = f'u{i + 1}{j + 1}{end}'
                made[times[i, j]] = _sum(terms)
                made[factors[i, j]] = f'{times[i, j]}/{d[j]}'
    for i in range(n):
        made[y[i]] = _sum([right[i], *(f'-{factors[i, k]}*{y[k]}' for k in range(i)
                                       if (i, k) in times)])
    for i in reversed(range(n)):
        made[x[i]] = _sum([f'{y[i]}/{d[i]}', *(
            f'-{factors[k, i]}*{x[k]}' for k in range(i + 1, n) if (k, i) in times)])
    return made, x


def _sum(terms: Sequence[str]) -> str:
    return terms[0] + ''.join(f' - {t[1:]}' if t.startswith('-') else f' + {t}'
                              for t in terms[1:])
