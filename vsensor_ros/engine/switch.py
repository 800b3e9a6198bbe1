"""
Who serves each channel: the sensor itself, a virtual sensor, or nobody.

A pure state machine: events and a time [ns] go in, a new Switch comes out; nothing else changes.
What isolation says is believed at once when it says 'faulty', and after a dwell when it says
'healthy'. So a fault that toggles makes one switch to the virtual sensor and none back.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from vsensor_ros.engine.choice import (
    Candidates,
    Choice,
    FaultSet,
    Never,
    perhaps,
    WHILE,
)
from vsensor_ros.engine.decision import CannotServe, Decision, Source
from vsensor_ros.engine.limits import BEYOND
from vsensor_ros.engine.policy import complete, Policy, RECOVERY
from vsensor_ros.observers import Design, Refusal
from vsensor_ros.reason import Reason

_TOLD = 1_000_000_000  # ns between two looks at the reasons: what they say of times grows old
_REAL: tuple[Source, FaultSet] = (Source.REAL, ())


@dataclass(frozen=True)
class Switch:
    """
    Which sensors are not believed, and for each channel the decision that follows from it.

    `faulty` is the effective set: those reported, those silent whose silence counts, those
    recovering (healthy since that time [ns], not yet believed) and those forced. Reports make it
    grow at once; it shrinks, and decisions change, in `decide` only.

    A virtual sensor of this set or of a superset, which reads none of the faulty sensors either,
    serves a channel: which of them is told in `Choice`.
    """

    design: Design
    policies: Mapping[str, Policy]
    decisions: Mapping[str, Decision]
    choice: Choice
    faulty: frozenset[str] = frozenset()
    reported: frozenset[str] = frozenset()
    silent: frozenset[str] = frozenset()
    forced: frozenset[str] = frozenset()
    recovering: Mapping[str, int] = field(default_factory=dict)
    latest: int = 0  # ns, of all times noted here: a clock that shows less was set back
    told: int | None = None  # ns at which the reasons were found; None: they are not up to date

    @classmethod
    def of(cls, design: Design, policies: Mapping[str, Policy] | None = None) -> Switch:
        """Begin with all sensors healthy; those that have no policy get the default one."""
        return cls(design, complete(design, policies or {}),
                   dict.fromkeys(design.sensors, Decision(Source.REAL)), Choice.of(design))

    @property
    def sensors(self) -> tuple[str, ...]:
        """All sensors, in the design's order."""
        return self.design.sensors

    @property
    def failed(self) -> frozenset[str]:
        """Those that something is wrong with now: reported, or silent and that counts."""
        return self.reported | {s for s in self.silent if self.policies[s].silent_is_faulty}

    # ------------------------------------------------------------------------------- events

    def isolate(self, names: Iterable[str], time: int) -> Switch:
        """Take these sensors as reported faulty, all others as healthy; KeyError if unknown."""
        reported = self._known(names)
        return self if reported == self.reported else self._report(time, reported, self.silent)

    def silence(self, names: Iterable[str], time: int) -> Switch:
        """Take these sensors as silent, all others as heard; KeyError if one is unknown."""
        silent = self._known(names)
        return self if silent == self.silent else self._report(time, self.reported, silent)

    def force(self, name: str, time: int, never: Never = perhaps) -> Switch:
        """
        Treat a sensor as faulty until it is released, as soon as that does no harm.

        A force is for tests and maintenance, so it never makes anything worse: the sensor goes on
        until a virtual one is ready, and the force ends by itself when that is lost, or when it
        leaves a sensor that did fail without a virtual one. never: tells why a virtual sensor
        cannot serve, however long one waits. Raises CannotServe when none could ever serve with
        the present faults; KeyError if unknown.
        """
        self._known((name,))
        if name in self.forced:
            return self
        others = self.failed | self.recovering.keys() | self.forced
        for channel in (name, *(s for s in self.sensors if s in others)):
            left = {key: never(key, channel)
                    for key in self.choice.candidates(others | {name}, channel)}
            if None in left.values() or (channel != name and all(
                    never(key, channel) for key in self.choice.candidates(others, channel))):
                continue
            failed = tuple(s for s in self.sensors if s in others | {name})
            raise CannotServe(name, channel, failed, next(iter(left.values()), None))
        return replace(self, forced=self.forced | {name}, told=None)

    def release(self, name: str, time: int) -> Switch:
        """End the force on a sensor, which is believed at once if it has not failed; KeyError."""
        self._known((name,))
        if name not in self.forced:
            return self
        return replace(self, forced=self.forced - {name}, told=None,
                       decisions=self._without_notes((name,)))

    def clear(self, name: str, time: int) -> Switch:
        """
        Believe a sensor that is healthy again at once, whatever it waits for.

        Raises ValueError, one line, when it is still faulty, latched or forced; KeyError if
        unknown.
        """
        self._known((name,))
        if name in self.reported:
            raise ValueError(f'{name}: isolation still reports it faulty; repair it first')
        if name in self.failed:
            raise ValueError(f'{name}: is still silent; check its driver first')
        if name in self.recovering and self.policies[name].recovery == 'latched':
            raise ValueError(f'{name}: is latched; reset the replacer')
        if name in self.forced:
            raise ValueError(f'{name}: is forced; release it')
        if name not in self.recovering:
            return self
        return replace(self, told=None,
                       recovering={s: t for s, t in self.recovering.items() if s != name})

    def reset(self, time: int) -> Switch:
        """Forget forces and all that recovering sensors wait for; what is reported stays."""
        decisions = self._without_notes(self.sensors)
        choice = self.choice.only(frozenset())
        if not (self.forced or self.recovering) and choice is self.choice and \
                decisions == self.decisions:
            return self
        return replace(self, forced=frozenset(), recovering={}, choice=choice, told=None,
                       decisions=decisions)

    def with_policies(self, policies: Mapping[str, Policy]) -> Switch:
        """Change the policies, for sensors that recover now, too; KeyError if one is unknown."""
        policies = complete(self.design, policies)
        if policies == self.policies:
            return self
        new = replace(self, policies=policies, told=None)
        failed = new.failed  # silence may count now
        return replace(new, faulty=self.faulty | failed, recovering={
            s: t for s, t in self.recovering.items() if s not in failed})

    # ----------------------------------------------------------------------------- decisions

    def decide(self, time: int, asked: Candidates) -> Switch:
        """
        Decide who serves each channel now; to be called after events and at each tick.

        A dwell that began after `time` begins then: a clock that was set back delays a recovery by
        no more than the dwell.
        """
        if not self.faulty and not self.forced and time >= self.latest:
            return self
        if time < self.latest:
            return self._set_back(time).decide(time, asked)
        recovering = {s: t for s, t in self.recovering.items() if not self._over(s, t, time)}
        if len(recovering) < len(self.recovering):
            return replace(self, recovering=recovering, told=None).decide(time, asked)
        choice = self.choice.given_up(self.faulty, self._serving(), {
            s: self._dwell(s) for s in self.faulty}, time, asked)
        noted = replace(self, choice=choice)
        faulty, ended, blocked = noted._force(asked)
        servers = {s: noted._server(s, faulty, time, asked) for s in self.sensors if s in faulty}
        servers.update(dict.fromkeys(self.faulty - faulty, _REAL))
        choice = choice.only(faulty).compared(faulty, {
            s: key for s, (source, key) in servers.items() if source is Source.VIRTUAL},
            time, asked)
        changed = any(server != (self.decisions[s].source, self.decisions[s].fault_set)
                      for s, server in servers.items())
        if not changed and faulty == self.faulty and choice is self.choice and not ended and \
                self.told is not None and 0 <= time - self.told < _TOLD:
            return self
        new = replace(self, faulty=faulty, forced=self.forced - ended, choice=choice, latest=time,
                      told=time)
        decisions = {s: new._decision(s, *servers.get(s, _REAL), blocked, asked)
                     for s in self.sensors}
        return replace(new, decisions=decisions)

    def untold(self) -> Switch:
        """Have the reasons found anew, for what they tell of has changed."""
        return replace(self, told=None)

    def reserve(self, name: str, time: int, asked: Candidates) -> Decision:
        """Return what would be decided for a channel if it were reported faulty, too."""
        if self.forced:  # that may end then
            would = replace(self.isolate(self.reported | {name}, time), told=None)
            return would.decide(time, asked).decisions[name]
        faulty = self.faulty | {name}
        failing = replace(self, faulty=faulty, reported=self.reported | {name}, latest=time)
        source, fault_set = failing._server(name, faulty, time, asked)
        return Decision(source, fault_set, None if source is Source.VIRTUAL else
                        failing._lack(name, faulty, asked))

    # --------------------------------------------------------------------------- what follows

    def _known(self, names: Iterable[str]) -> frozenset[str]:
        found = frozenset(names)
        unknown = sorted(found.difference(self.policies))
        if unknown:
            raise KeyError(f'{", ".join(unknown)}: no such sensor')
        return found

    def _report(self, time: int, reported: frozenset[str], silent: frozenset[str]) -> Switch:
        before = self.failed
        new = replace(self, reported=reported, silent=silent, told=None)
        failed = new.failed
        recovering = {s: t for s, t in self.recovering.items() if s not in failed}
        recovering.update(dict.fromkeys(before - failed, time))
        return replace(new, recovering=recovering, faulty=self.faulty | failed,
                       latest=max(self.latest, time))

    def _set_back(self, time: int) -> Switch:
        return replace(
            self, latest=time, told=None,
            choice=self.choice.set_back(time),
            recovering={s: min(t, time) for s, t in self.recovering.items()})

    def _dwell(self, name: str) -> int:
        return round(self.policies[name].dwell * 1e9)

    def _over(self, name: str, since: int, time: int) -> bool:
        return self.policies[name].recovery == 'automatic' and time - since >= self._dwell(name)

    def _serving(self) -> dict[str, FaultSet]:
        return {s: d.fault_set for s, d in self.decisions.items() if d.source is Source.VIRTUAL}

    def _server(self, name: str, faulty: frozenset[str], time: int,
                asked: Candidates) -> tuple[Source, FaultSet]:
        """Return who serves a channel when all of these are faulty."""
        key = self.choice.choose(name, faulty, self.decisions[name].fault_set, time, asked)
        return (Source.NONE, ()) if key is None else (Source.VIRTUAL, key)

    def _force(self, asked: Candidates) -> tuple[frozenset[str], frozenset[str], dict[str, str]]:
        """Return the effective set, whose force ends, and by forced one whom it would harm."""
        core = faulty = self.failed | self.recovering.keys()
        ended, blocked = set(), {}
        wanted = [s for s in self.sensors if s in self.forced - core]
        for name in sorted(wanted, key=lambda s: self.decisions[s].source is not Source.VIRTUAL):
            serves = self.decisions[name].source is Source.VIRTUAL
            harmed = self._harmed(core, faulty | {name}, asked)
            if harmed is None and not serves and \
                    self.choice.better_to_come(faulty | {name}, name, asked):
                harmed = name  # which is live: nothing is lost by waiting
            if harmed is None:
                faulty |= {name}
                continue
            blocked[name] = harmed
            if serves:
                ended.add(name)
        return faulty, frozenset(ended), blocked

    def _harmed(self, core: frozenset[str], faulty: frozenset[str],
                asked: Candidates) -> str | None:
        """Return who has no virtual sensor when all of these are faulty, and could without."""
        for channel in self.sensors:
            if channel in faulty:
                left = self.choice.candidates(faulty, channel)
                present = self.decisions[channel].fault_set
                if not any(self.choice.able(key, channel, present, asked) for key in left) and (
                        channel not in core or left != self.choice.candidates(core, channel)):
                    return channel
        return None

    # ------------------------------------------------------------------------------ reasons

    def _without_notes(self, names: Iterable[str]) -> dict[str, Decision]:
        decisions = dict(self.decisions)
        for name in names:
            if decisions[name].source is Source.REAL:
                decisions[name] = Decision(Source.REAL)
        return decisions

    def _decision(self, name: str, source: Source, fault_set: FaultSet,
                  blocked: Mapping[str, str], asked: Candidates) -> Decision:
        """Add why the channel is served as it is."""
        reason: Reason | None = None
        if name in blocked:
            harmed = blocked[name]
            code = 'force waits' if name in self.forced else 'force ended'
            why = self._lack(harmed, self.faulty | {name}, asked)
            reason = Reason.of(code, why=why) if harmed == name else \
                Reason.of(f'{code} for another', harmed=harmed, why=why)
        elif source is Source.NONE:
            reason = self._lack(name, self.faulty, asked)
        elif source is Source.VIRTUAL:
            reason = self._why(name)
            if (left := asked.why_not(fault_set, name)) is not None:
                reason = Reason.of('serves early', why=reason, left=left)
            if len(fault_set) > len(self.faulty):
                exact = tuple(s for s in self.sensors if s in self.faulty)
                reason = Reason.of('served by a superset', why=reason,
                                   exact=self._lack_of(exact, name, asked))
        elif self.decisions[name].source is source and name not in self.forced:
            return self.decisions[name]  # with the note, if any, that a force ended
        return Decision(source, fault_set, reason)

    def _lack(self, name: str, faulty: frozenset[str], asked: Candidates) -> Reason:
        """Return why neither the exact set's virtual sensor serves nor the next best."""
        exact = tuple(s for s in self.sensors if s in faulty)
        lack = self._lack_of(exact, name, asked)
        for key in self.choice.candidates(faulty, name):
            if key != exact:
                return Reason.of('next best', exact=lack, fault_set=key,
                                 next=self._lack_of(key, name, asked))
        return lack

    def _lack_of(self, fault_set: FaultSet, name: str, asked: Candidates) -> Reason:
        entry = self.design.entries.get((fault_set, name))
        if isinstance(entry, Refusal):
            return Reason.of('refused', text=entry.reason)
        if entry is None:
            return Reason.of('no design', failed=tuple(
                s if s in self.reported else Reason.of('named', name=s, why=self._why(s))
                for s in fault_set))
        lost, why = self.choice.lost.get(name, {}), asked.why_not(fault_set, name)
        if (again := lost.get(fault_set)) is not None:
            return Reason.of('ready again', seconds=(self.latest - again) * 1e-9,
                             dwell=max(self.policies[name].dwell, WHILE * 1e-9))
        if fault_set in lost and (fault_set, name) in self.choice.temporary:
            if why is None:
                return Reason('had its time')
            if why.code in BEYOND:
                return Reason.of('served its time', why=why)
        if fault_set in lost and why is None:
            why = asked.why_not_again(fault_set, name)
        return why or Reason.of('less sure', fault_set=fault_set,
                                deviation=asked.deviation(fault_set, name))

    def _why(self, name: str) -> Reason:
        """Return why a faulty sensor is not believed."""
        if name in self.reported:
            return Reason('isolated')
        if name in self.failed:
            return Reason('silent')
        if name in self.recovering:
            policy = self.policies[name]
            return Reason.of(RECOVERY[policy.recovery], dwell=policy.dwell)
        return Reason('forced')
