"""
The ladder of orders for one problem: what each order can do, and which one is taken.

Each order is either shown impossible or given its quietest virtual sensor found. Least is not the
same as usable: the default takes the least order whose noise is within QUIET of the best.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from vsensor_ros.designer.candidates import (
    filters,
    Ground,
    grounds,
    JudgedCandidate,
    of_family,
    of_spectra,
    on_invariant_spaces,
    stacked,
    static,
    whole,
)
from vsensor_ros.designer.choice import most_valid
from vsensor_ros.designer.error_in_box import feeding_terms
from vsensor_ros.designer.exact import ExactVerdict
from vsensor_ros.designer.existence import examine, Existence
from vsensor_ros.designer.fixed_spectrum import MOST_MODES, SPARING
from vsensor_ros.designer.invariant_spaces import lower_bound
from vsensor_ros.designer.noise import noise_model, usual_decay
from vsensor_ros.designer.observer import build, Candidate
from vsensor_ros.designer.order import families, Family, first_orders, sure_order
from vsensor_ros.designer.order_walk import by_strides, LARGE, Listed
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.sentences import say
from vsensor_ros.designer.stabilise import stable_members
from vsensor_ros.designer.subspaces import Gap, RANK_TOLERANCE
from vsensor_ros.functions.nonlinearity import set_valued
from vsensor_ros.observers import (
    Noise,
    OrderStep,
    Proof,
    Refusal,
    Rung,
    VirtualSensor,
)
from vsensor_ros.reason import Reason

QUIET = 2.0  # the least order is taken whose noise is within this factor of the best
SLUGGISH = 0.5  # of the wanted decay rate: slower is taken only where nothing is faster
LIVELY = 1.25  # where no rate is wanted, the fastest is taken at so much of the least noise
SLOWER = 4.0  # the decay rate may fall by so much for reading fewer sensors
MOST_RUNGS = 12  # looked at, before the filter is taken instead

_Rungs = dict[int, tuple[JudgedCandidate, VirtualSensor]]


def search_orders(problem: Problem, existence: Existence, avoid: frozenset[int], prefer: str,
                  decay: float | None, exact: ExactVerdict | None,
                  validity: bool = True) -> VirtualSensor | Refusal:
    """
    Return the virtual sensor for a problem that has one, with its proof and its ladder.

    ``existence``: of the problem itself, on which the proof rests; ``avoid``: nonlinear terms
    that the virtual sensor is to be decoupled from besides. ``prefer``: 'quiet' or 'least'.
    ``exact``: what exact arithmetic says of the problem, if it can. ``validity``: whether what is
    proved of a virtual sensor goes before its rank; it then has its certificate.
    """
    assert existence.quotient is not None
    noise = noise_model(problem)
    wanted = usual_decay(problem) if decay is None else decay
    # what is asked for is to be met, not nearly met
    enough = SLUGGISH * wanted if decay is None else wanted
    where = grounds(problem, existence, avoid, noise, wanted)
    base = where[0] if where[0].known is existence.quotient else Ground(
        problem, existence.quotient, where[0].terms[:0], noise, wanted)
    steps: list[OrderStep] = []
    freedom = exact.freedom if exact else None
    doubts = doubtful(existence.gap, 'whether one exists', exact)
    rungs: _Rungs = {}

    reserve = [c for g in where for c in (*filters(g, decay is not None), *whole(g))]
    if len(problem.V) > 1 or any(len(g.terms) for g in where):
        reserve += [c for g in where for c in on_invariant_spaces(g)]
    bound = min(lower_bound(g.known, np.vstack([g.known.v, g.terms])) for g in where)
    if len(problem.V) > 1:
        least = first_orders(base.known, freedom)
        reserve += stacked(base, lambda one: _single(one, avoid, prefer, decay), least,
                           _most(where, reserve, prefer, enough))
        bound = max(bound, *least)
    proofs = Listed(_families_by_order(base, freedom[0] if freedom else None))
    of_grounds = [Listed(_families_by_order(g, None)) for g in where]
    met = list(reserve)

    def chosen(k: int) -> VirtualSensor:
        order = k
        if validity:
            rivals = met if prefer == 'quiet' else [c for c in met if c.order == k]
            order = _prove(problem, rungs, k, rivals, enough)
        return _chosen(rungs, order, base, steps, doubts, decay, freedom)

    def look(k: int) -> bool:
        """Put the quietest of order k on its rung, if there is one; whether it is good enough."""
        here = [c for c in reserve if c.order == k]
        proof = proofs.at(k)
        if k == 0:
            here += static(where[0])
        for ground, of_ground in zip(where, of_grounds):
            family = proof if ground.known is base.known else of_ground.at(k)
            if k and family is not None and family[0] is not None:
                made = of_family(ground, family[0])
                here, met[:] = here + made, met + made
        found = _quietest_built(problem, where, here, enough, 1.0 if decay else LIVELY)
        if found is None:
            step = _excluded(k, base, proof, bound, exact is not None)
        else:
            rungs[k] = found
            step = OrderStep(k, 'possible', say(_how_found(problem, *found)),
                             len(proof[0].F) if proof and proof[0] else 0,
                             _numbers(proof[1] if proof else Gap()))
        steps.append(step)
        if not (exact and base.known.order > LARGE):  # there each singular value is in doubt
            doubts.extend(doubtful(proof[1], f'order {k}', exact) if proof else [])
        return k in rungs and (prefer == 'least' or _good(rungs, k, reserve, enough))

    top = max(g.known.order for g in where)
    for k in range(top + 1):
        if base.known.order > LARGE and (proofs.at(k) or (None,))[0] is not None:
            at = by_strides(look, k, max(k, min(top, MOST_MODES)))
            if at is not None:
                return chosen(at)
            break
        if look(k):
            return chosen(k)
        if len(rungs) >= MOST_RUNGS:
            break
    # no order was good enough: take the best there is
    if not rungs:
        reserve += [c for g in where for c in on_invariant_spaces(g)]
        met = list(reserve)
    for k in sorted({c.order for c in reserve}):
        found = _quietest_built(problem, [], [c for c in reserve if c.order == k], enough, 1.0)
        if found is not None:
            rungs.setdefault(k, found)
    if not rungs:
        return _refusal(base, doubts)
    good = [k for k in sorted(rungs) if prefer == 'least' or _good(rungs, k, [], enough)]
    return chosen(good[0])


def _prove(problem: Problem, rungs: _Rungs, k: int, rivals: list[JudgedCandidate],
           enough: float) -> int:
    """Certify rung k, or put what is proved of more in its place; return the order of that."""
    fast = _fast([*rivals, rungs[k][0]], enough)
    least = min(c.error for c in fast)
    # by order, the fastest of nearly the least noise first, as where all are proved alike
    fast.sort(key=lambda c: (c.order, -c.decay if c.error <= LIVELY * least else c.error))
    built = {rungs[k][1]: rungs[k][0]}

    def ranked() -> Iterator[VirtualSensor]:
        yield rungs[k][1]
        alike = {_likeness(*rungs[k])}
        for c in fast:
            sensor = build(problem, c.candidate, c.method) if c.error <= QUIET * least else None
            if sensor is not None and _likeness(c, sensor) not in alike:
                alike.add(_likeness(c, sensor))
                built[sensor] = c
                yield sensor

    sensor, certificate = most_valid(problem.plant, ranked())
    candidate = built[sensor]
    rungs[candidate.order] = candidate, replace(sensor, certificate=certificate)
    return candidate.order


def _likeness(c: JudgedCandidate, sensor: VirtualSensor) -> tuple[object, ...]:
    """Return what virtual sensors have in common that are proved alike, in all likelihood."""
    return (c.order, *feeding_terms(sensor), *np.round(10 * np.log([c.error, c.decay])))


def _single(problem: Problem, avoid: frozenset[int], prefer: str,
            decay: float | None) -> Candidate | None:
    """Return the virtual sensor for one row, in the scaled coordinates of its problem."""
    existence = examine(problem)
    if existence.quotient is None:
        return None
    found = search_orders(problem, existence, avoid, prefer, decay, None, validity=False)
    if isinstance(found, Refusal):
        return None
    return Candidate(found.Phi * problem.scale, found.N, found.J * problem.y0_size,
                     found.Cv / problem.v_size[:, None],
                     found.Q * problem.y0_size / problem.v_size[:, None])


def _families_by_order(ground: Ground, freedom: Sequence[int | None] | None,
                       ) -> Iterator[tuple[Family | None, Gap]]:
    """Yield for k = 0, 1, .. the family of order k or None, and the gap; one functional only."""
    if len(ground.known.v) > 1:
        return
    yield None, Gap()
    if not ground.measured:
        for _, family, gap in families(ground.known, freedom):
            yield family, gap


def _quietest_built(problem: Problem, where: list[Ground], candidates: list[JudgedCandidate],
                    enough: float, lively: float,
                    ) -> tuple[JudgedCandidate, VirtualSensor] | None:
    """
    Build the quietest candidate that is fast enough, or one nearly as good that reads less.

    ``lively`` above 1: the fastest whose noise is within this factor of the least. Candidates
    that fail the check of their equations are left out.
    """
    while candidates:
        fast = _fast(candidates, enough)
        limit = lively * min(c.error for c in fast)
        best = max((c for c in fast if c.error <= limit),
                   key=lambda c: (c.decay if lively > 1 else 0.0, -c.error))
        sensor = build(problem, best.candidate, best.method)
        if sensor is None:
            candidates = [c for c in candidates if c is not best]
            continue
        rivals = [c for c in fast if c is not best]
        if len(problem.V) == 1 and best.order:  # the same spectrum, with fewer sensors read
            rivals += [c for g in where for c in of_spectra(g, [sensor.eigenvalues])
                       if c.order == best.order]
        chosen = best, sensor
        for rival in rivals:
            if rival.error > SPARING * best.error or rival.decay < best.decay / SLOWER:
                continue
            other = build(problem, rival.candidate, rival.method)
            if other is not None and len(other.reads) < len(chosen[1].reads) and (
                    other.reads or rival.decay >= best.decay):
                chosen = rival, other
        return chosen
    return None


def _fast(candidates: list[JudgedCandidate], enough: float) -> list[JudgedCandidate]:
    """Return the candidates that decay fast enough; if none does, the fastest and near ones."""
    fastest = max(c.decay for c in candidates)
    least = enough * (1 - 1e-6) if fastest >= enough else SLUGGISH * fastest
    return [c for c in candidates if c.decay >= least]


def _good(rungs: _Rungs, k: int, reserve: list[JudgedCandidate], enough: float) -> bool:
    """Whether rung k is fast and quiet enough to be taken, as far as is known."""
    rivals = [*(c for c, _ in rungs.values()), *reserve]
    fast = _fast(rivals, enough)
    own = rungs[k][0]
    return any(c is own for c in fast) and own.error <= QUIET * min(c.error for c in fast)


def _most(where: list[Ground], reserve: list[JudgedCandidate], prefer: str,
          enough: float) -> float:
    """Return an order beyond which a virtual sensor can be no better than one of the reserve."""
    floor = where[0].floor  # of least decoupling
    if not reserve or any(len(g.terms) for g in where) or not np.isfinite(floor):
        return np.inf  # validity, too, may decide
    taken = QUIET / (LIVELY * SPARING) * floor  # a rung with such a candidate is taken
    return min((c.order for c in _fast(reserve, enough)
                if prefer == 'least' or (c.error <= taken and c.decay >= enough)), default=np.inf)


def _excluded(k: int, base: Ground, proof: tuple[Family | None, Gap] | None,
              bound: int, exact: bool) -> OrderStep:
    """Say why there is no virtual sensor of order k, or that this is open."""
    def step(verdict: str, why: Reason, freedom: int = 0) -> OrderStep:
        return OrderStep(k, verdict, say(why), freedom, _numbers(proof[1] if proof else Gap()))

    if 0 < k < bound:
        return step('impossible', Reason.of('too few states', least=bound))
    if k == 0 and not base.measured:
        return step('impossible', Reason.of('no combination of readings'))
    if proof is None or k == 0:
        return step('open', Reason.of('none found'))
    family = proof[0]
    if family is None:
        return step('impossible', Reason.of('no polynomial'))
    if family.free:
        return step('open', Reason.of('no digits') if exact else Reason.of('any spectrum'), k)
    if k > MOST_MODES and len(family.F):
        return step('open', Reason.of('polynomial too large'), len(family.F))
    none = stable_members(family, base.noise.sample_time, base.decay)[1]
    if none is None:
        return step('open', Reason.of('none passes'), len(family.F))
    # of what is proved of the coefficients nothing is left where their digits are rounding
    sure = none.proved and not (exact and base.known.order > LARGE and proof[1].doubtful)
    return step('impossible' if sure else 'open', none.why, len(family.F))


def _how_found(problem: Problem, candidate: JudgedCandidate, sensor: VirtualSensor) -> Reason:
    size = float(problem.v_size.max())
    if candidate.error <= size:
        return Reason.of('found', method=sensor.method)
    return Reason.of('found of no use', method=sensor.method, error=candidate.error, size=size)


def _numbers(gap: Gap) -> tuple[float, float]:
    return gap.zero, gap.nonzero if np.isfinite(gap.nonzero) else 1.0


def _chosen(rungs: _Rungs, k: int, base: Ground, steps: list[OrderStep],
            doubts: list[str], decay: float | None,
            freedom: Sequence[Sequence[int | None]] | None) -> VirtualSensor:
    """Return rung k with the proof, the ladder and its noise against the floor."""
    candidate, sensor = rungs[k]
    if decay is not None and candidate.decay < 0.99 * decay:
        doubts = [*doubts, say(Reason.of('slower than wanted', wanted=decay,
                                         found=candidate.decay))]
    upper, modulo = min(rungs), freedom is not None and base.known.order > LARGE
    if modulo and freedom is not None:
        upper = min(upper, sum(map(sure_order, freedom)))  # those of single rows, side by side
    steps = sorted(steps, key=lambda s: s.order)
    lower = max([s.order + 1 for s in steps if s.verdict == 'impossible' and s.order < upper],
                default=0)
    # with a polynomial p of one order there is (s + a) p of the next
    steps = [s if s.order >= lower or s.verdict == 'impossible' else replace(
        s, verdict='impossible', why=say(Reason.of('impossible above', order=lower - 1)))
        for s in steps]
    steps = [s for s in steps if s.order < lower or s.verdict != 'impossible']
    ladder = tuple(Rung(order, c.error, v.noise_gain, c.decay, v.method)
                   for order, (c, v) in sorted(rungs.items()))
    floor = min([c.error for c, _ in rungs.values()] + (
        [base.floor] if np.isfinite(base.floor) else []))
    return replace(sensor, ladder=ladder,
                   noise=Noise(candidate.error, floor, base.noise.assumed),
                   proof=Proof(lower, upper, tuple(steps),
                               tuple(dict.fromkeys(doubts)), modulo))


def _refusal(base: Ground, doubts: list[str]) -> Refusal:
    problem = base.problem
    terms = problem.plant.terms
    return Refusal(problem.channel, problem.fault_set, say(Reason.of(
        'none stable', order=base.known.order, terms=tuple(term.short for term in terms),
        signs=any(set_valued(term) for term in terms))), doubts=tuple(dict.fromkeys(doubts)))


def doubtful(gap: Gap, what: str, exact: ExactVerdict | None) -> list[str]:
    """Say which rank decisions were ambiguous, and whether exact arithmetic settled them."""
    if not gap.doubtful:
        return []
    return [say(Reason.of('ambiguous ranks', what=what, zero=gap.zero, nonzero=gap.nonzero,
                          limit=RANK_TOLERANCE, settled=exact is not None))]
