"""Equations M a = b of a mechanism, solved for a in definitions: M = L D L' (Cholesky)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def solved(mass: Mapping[tuple[int, int], str], right: Sequence[str],
           ) -> tuple[dict[str, str], list[str]]:
    """
    Return definitions, and the names of the accelerations.

    mass: names or numbers of what stands in M at (i, j), j <= i, where it is not 0; right: b, by
    name. The definitions are `d1`, `l21`, `y1`, `acceleration1` and the like, counted from 1.
    """
    n, made = len(right), dict[str, str]()
    times: dict[tuple[int, int], str] = {}  # l_ik d_k, by name
    for i in range(n):
        for j in range(i + 1):
            terms = [mass[i, j]] if (i, j) in mass else []
            terms += [f'-{times[i, k]}*l{j + 1}{k + 1}' for k in range(j)
                      if (i, k) in times and (j, k) in times]
            if not terms:
                continue
            total = _sum(terms)
            if i == j:
                made[f'd{i + 1}'] = total
            else:
                times[i, j] = f'u{i + 1}{j + 1}'
                made[times[i, j]] = total
                made[f'l{i + 1}{j + 1}'] = f'{times[i, j]}/d{j + 1}'
    for i in range(n):
        made[f'y{i + 1}'] = _sum([right[i], *(f'-l{i + 1}{k + 1}*y{k + 1}' for k in range(i)
                                              if (i, k) in times)])
    for i in reversed(range(n)):
        made[f'acceleration{i + 1}'] = _sum([f'y{i + 1}/d{i + 1}', *(
            f'-l{k + 1}{i + 1}*acceleration{k + 1}' for k in range(i + 1, n) if (k, i) in times)])
    return made, [f'acceleration{i + 1}' for i in range(n)]


def _sum(terms: Sequence[str]) -> str:
    return terms[0] + ''.join(f' - {t[1:]}' if t.startswith('-') else f' + {t}'
                              for t in terms[1:])
