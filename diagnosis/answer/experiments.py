"""Propose experiments that the rig can do, and rank them by how well they separate the candidates for their time.

Each is a bending or elongation run with one thing changed, short enough to be worth its time: three spine lengths, three
pressures, two repeats. Its expected information is the mutual information, in bits, between candidate and outcome, by drawing
outcomes from what the candidates predict (`rivals`), with a fixed seed.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from model.actuators import Words
from model.condition import NOMINAL_VACUUM, TIP
from model.effects.design import QUATERNION, Columns
from model.effects.scales import scales
from model.robot import Robot

from ..arrays import Array, rounded
from ..criticism.relatives import PLACES, walls
from ..data.campaign import Campaign, tip_masses
from ..inference.executor import SINGLE_THREAD, DiagnosisStep, Executor
from ..inference.posterior import UNKNOWN
from ..inference.prepare import Prepared
from ..judgement import LEAST_BITS, OVERHEAD_MIN, RIVAL_LEAST_WEIGHT, RIVAL_WORTH_SEPARATING, SEPARATED_BITS
from .attribute import Attribution
from .headline import relative
from .result import Proposal
from .rivals import RivalForecast, Rivals
from .verdict import at_places

PER_TRIAL = 25.0
"""s: release, grow, jam and vent."""
TURN, MILD, MASS = 90.0, 0.6, 0.07
"""deg the body is turned; share of the highest pressure that all actuators have at most together; mass hung on in addition, in
the scale of its robot: 100 g on a body of 40 cm, 2 g on one of 12."""


# ------------------------------------------------------------------ the menu
def candidate_experiments(robot: Robot, s: Campaign) -> list[Proposal]:
    """Experiments that the campaign lacks, not yet ranked."""
    trials = s.trials
    main, count, words = np.flatnonzero(s.kind == 0), len(robot.actuators.azimuths_deg), robot.actuators.words
    chambers = list(s.chambers[main[np.argmax(s.highest[main])]])  # of the state with the highest pressure of the main sweep
    rest = 0.0 if words.by_rig else rounded(float(np.quantile(s.pressure, 0.1)), 2)  # tendons are kept taut
    grain = 10.0 ** (np.floor(np.log10(s.highest.max())) - 2)  # three digits, which may not round it up
    limit = robot.highest_limit or float(np.floor(s.highest.max() / grain + 1e-9) * grain)
    pressures_used = np.minimum(s.highest[s.highest > rest + s.pressure_gap], limit)
    pressures = np.unique(np.minimum(_three(pressures_used, s.pressure_gap), limit)).tolist()
    mass = float(np.median(tip_masses(robot, trials)))
    default_vacuum = NOMINAL_VACUUM if robot.spine is not None else 0.0
    vacuum = float(np.median(trials.get("vacuum", default_vacuum)))
    base: dict[str, Any] = {
        "protocol": "bending", "spine_lengths": _three(s.spine_length, 0.005), "pressures": pressures, "chambers": chambers,
        "unload": False, "repeats": 2, "rate": 25e3, "tip_mass": mass, "vacuums": [round(vacuum, -3)],
    } | ({"rest": rest} if rest else {})  # fmt: skip
    offered: list[Proposal] = []
    more = rounded(MASS * scales(robot).of("kg"), 1)

    def offer(id: str, do: str, hands: float = 0.0, channels: tuple[str, ...] = (), **changed: Any) -> None:
        protocol = {**base, **changed}
        most = min(robot.pressure_limits[c - 1] for c in protocol["chambers"])
        protocol["pressures"] = np.unique(np.minimum(protocol["pressures"], most)).tolist()
        planned_states = _states(protocol)
        rig = float(PER_TRIAL * planned_states["trial"][-1] + planned_states["seconds"].sum())  # s
        offered.append(Proposal(id, do, (), 0.0, round(hands + rig / 60, 1), protocol, hands, channels))

    mild, every = pressures_used[pressures_used <= MILD * max(pressures)], list(range(1, count + 1))
    lower = _three(mild, s.pressure_gap) if mild.size else [rounded(MILD * p, 2) for p in pressures]
    if not (s.branch < 0).any():
        offer("unload", "read the unload branch too", unload=True)
    if not np.isfinite(trials.orientation).any():
        offer("orientation", "track the tip's orientation (rigid body in motion capture)", 5.0, QUATERNION)
    if trials.pressures.min(axis=1).max() <= s.pressure_gap:
        together = f"{words.inflate} all {words.actuators} together"
        offer("elongation", together, protocol="elongation", pressures=lower, chambers=every)
    shifts = sorted(range(1, count), key=lambda shift: (shift != count // 3, shift))
    shifted = (sorted((c - 1 + shift) % count + 1 for c in chambers) for shift in shifts)  # round the ring
    if other_group := next((group for group in shifted if tuple(group) not in s.chambers), None):
        offer(f"other_{words.actuators}", f"{words.inflate} {words.group(other_group)} instead", chambers=other_group)
    if np.ptp(np.round(trials.get("roll_deg", 0.0))) == 0:
        offer("roll", f"turn the body by {TURN:g} deg in its mount", 15.0, roll_deg=TURN)
    if np.ptp(np.round(trials.get("tip_mass", 0.0), 3)) == 0:
        offer("tip_mass", f"hang about {more * 1e3:g} g more on the tip", 3.0, tip_mass=round(mass + more, 5))
    offer("hold", f"hold each {words.pressure} and read it repeatedly", reading="hold", hold_times=[2.0, 10.0, 30.0])
    if not (trials.get("hold") <= 0).any():
        offer("rate", "ramp fast up and down, and read without stopping", reading="sweep", rate=100e3, unload=True)
    if robot.spine is not None and (between := _between(s.spine_length, 0.005)):
        lengths_cm = ", ".join(f"{x * 100:g}" for x in between)
        offer("lengths", f"spine lengths in between: {lengths_cm} cm", spine_lengths=between)
    vacuums = np.unique(np.round(trials.get("vacuum", 0.0)[trials.spine_length > 0.01] / 10e3))
    if robot.spine is not None and len(vacuums) <= 2:
        offer("vacuum", "sweep the vacuum", vacuums=[round(share * vacuum, -3) for share in (0.5, 0.75, 1.0)])
    if between := _between(pressures_used, s.pressure_gap):
        offer("pressures", f"{words.pressures} in between", pressures=between)
    if robot.markers and not np.isfinite(trials.markers).any():
        names = tuple(f"m{k}{axis}" for k in range(1, len(robot.markers) + 1) for axis in "xyz")
        offer("markers", "put markers along the body", 20.0, names)
    return offered


def _three(values: Array, gap: float) -> list[float]:
    """Lowest, middle and highest of the settings used, rounded to the setting's grain and to three digits."""
    known = np.unique(np.round(values / gap) * gap)
    return [rounded(x, 3) for x in np.unique(known[[0, len(known) // 2, -1]] if known.size else known)]


def _between(values: Array, gap: float) -> list[float]:
    """Settings half-way between those used, where these are few."""
    known = np.unique(np.round(values / gap) * gap)
    return [rounded(x, 3) for x in (known[:-1] + known[1:]) / 2] if len(known) <= 4 else []


# ------------------------------------------------------------------ its states
def _states(p: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """The states in the order in which the protocol visits them, column by column, and the seconds that each takes."""
    rest = p.get("rest", 0.0)
    up = [(x, "load") for x in [rest, *p["pressures"]]]
    down = [(x, "unload") for x in [*p["pressures"][-2::-1], rest]] if p["unload"] else []
    # s from the ramp's end to the middle of a settled reading
    holds = {"settled": [3.0], "sweep": [0.0], "hold": p.get("hold_times", [])}[p.get("reading", "settled")]
    sweeps, rows = itertools.product(range(1, p["repeats"] + 1), p["vacuums"], p["spine_lengths"]), []
    for trial, sweep in enumerate(sweeps, 1):
        last_pressure = rest
        for pressure, branch in up + down:
            ramp_time, last_pressure, waited = abs(pressure - last_pressure) / p["rate"], pressure, 0.0
            for hold in holds:
                rows.append((trial, *sweep, pressure, branch, hold, ramp_time + max(hold - waited, 0.0) + 1.0))
                ramp_time, waited = 0.0, hold
    names = ("trial", "repeat", "vacuum", "spine_length", "pressure", "branch", "hold", "seconds")
    return dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))


def columns(p: Mapping[str, Any], chambers: int, channels: tuple[str, ...]) -> Columns:
    """The table of trials that protocol parameters would give; measured channels hold zeros (orientation: no turn)."""
    states, rest = _states(p), p.get("rest", 0.0)
    pressure, seconds = states.pop("pressure"), states.pop("seconds")
    by_state: dict[str, Any] = {"t": np.cumsum(seconds), **states}
    by_state |= {f"p{c}": np.where(c in p["chambers"], pressure, rest) for c in range(1, chambers + 1)}
    of_all = {"roll_deg": 0.0} | {name: p[name] for name in ("protocol", "rate", "tip_mass", "roll_deg") if name in p}
    of_all |= {name: 1.0 if name == "qw" else 0.0 for name in channels}
    return by_state | {name: np.full(len(seconds), value) for name, value in of_all.items()}


def to_apply(p: Mapping[str, Any], words: Words) -> str:
    """The states that protocol parameters ask for in one line, for a robot that no rig drives.

    >>> from model.actuators import Tendons
    >>> sweep = {"pressures": [20e3, 45e3], "chambers": [2], "unload": True, "repeats": 2, "rate": 25e3}
    >>> to_apply(sweep, Tendons.words)
    'tendon 2: 0, 2, 4.5 N and back, 2 times, at 2.5 N/s'
    """
    levels = ", ".join(f"{x / words.pascal:.6g}" for x in (p.get("rest", 0.0), *p["pressures"]))
    parts = [f"{words.group(p['chambers'])}: {levels} {words.unit}{' and back' if p['unload'] else ''}"]
    parts += [f"{p['repeats']} times", f"at {p['rate'] / words.pascal:.3g} {words.unit}/s"]
    if p.get("hold_times"):
        parts.append(f"read after {', '.join(f'{x:g}' for x in p['hold_times'])} s")
    if any(p.get("spine_lengths", ())):
        parts.append(f"spine {', '.join(f'{100 * x:g}' for x in p['spine_lengths'])} cm")
    return ", ".join(parts)


# ------------------------------------------------------------------ which of them
def propose(f: Attribution, rivals: Rivals, executor: Executor = SINGLE_THREAD) -> tuple[Proposal, ...]:
    """Experiments that are not in the campaign and are expected to tell `LEAST_BITS`; none after stiffness trials alone.

    Those that separate candidates with a probability above `RIVAL_WORTH_SEPARATING` come first, then those with most bits for
    their time; where a person sets each state, which takes a time unknown, those with most bits. Where a relative explains more
    than the catalogue, separating effects of it tells as much less as they are improbable together.
    """
    p = f.prepared
    if len(rivals.candidates) < 2 or p.pushes_only:
        return ()
    menu = candidate_experiments(p.robot, p.states.take(~p.states.pushed))
    possible = frozenset(" + ".join(h) or "none" for h, share in f.posterior.ranking if share > RIVAL_WORTH_SEPARATING)
    proposals = executor.map(partial(_proposal, p, rivals, possible), menu, DiagnosisStep.EXPERIMENTS)

    def worth(x: Proposal) -> float:
        return x.expected_bits / (x.cost_min + OVERHEAD_MIN) if p.robot.actuators.words.by_rig else x.expected_bits

    within = 1 - f.decision.outside if f.decision.verdict == "unknown" and f.decision.relatives else 1.0
    told = [replace(x, expected_bits=round(within * x.expected_bits, 3)) for x in proposals if x is not None]
    if (at_wall := _at_wall(f, next(x for x in menu if x.id == "hold"))) is not None:
        told.append(replace(at_wall, separates=((UNKNOWN[0], rivals.names[0]),) if rivals.names[0] in possible else ()))
    return tuple(sorted((x for x in told if x.expected_bits >= LEAST_BITS), key=lambda x: (not x.separates, -worth(x))))


def _at_wall(f: Attribution, hold: Proposal) -> Proposal | None:
    """The test that decides on a leading relative at walls: one chamber is held, at the wall where the relative is surest."""
    id, robot = next(iter(f.decision.relatives), ""), f.prepared.robot
    sizes = at_places(f).get(id, {})
    if f.decision.verdict != "unknown" or not sizes or PLACES[id][0] is not walls:
        return None
    first, _ = max(zip(walls(robot), sizes.values(), strict=True), key=lambda at: abs(at[1].value) / at[1].sd)[0]
    share = np.array([f.decision.outside, 1 - f.decision.outside]).clip(RIVAL_LEAST_WEIGHT, 1 - RIVAL_LEAST_WEIGHT)
    bits, do = round(float(-share @ np.log2(share)), 3), relative(id, {id: sizes}, robot.actuators.words)[1]
    return replace(hold, id=id, do=do, expected_bits=bits, protocol={**hold.protocol, "chambers": [first]})


def _proposal(p: Prepared, rivals: Rivals, possible: frozenset[str], x: Proposal) -> Proposal | None:
    """An experiment with what it would tell; None where a rival has no equilibrium there."""
    predictions = rivals.predict(planned(p, x))
    if predictions is None:
        return None
    bits, pairs = _information(predictions, rivals.weight)
    separated = (tuple(rivals.names[k] for k in pair) for pair in pairs)
    return replace(x, separates=tuple(pair for pair in separated if possible.issuperset(pair)), expected_bits=round(bits, 3))


def planned(p: Prepared, x: Proposal) -> Columns:
    """The table's columns that an experiment would give, in the channels that the campaign has and those that it adds."""
    known = set(p.labels.channel.tolist())
    channels = (*(name for name in TIP if name in known), *(QUATERNION if "rx" in known else ()), *x.channels)
    return columns(x.protocol, len(p.robot.actuators.azimuths_deg), tuple(dict.fromkeys(channels)))


def _information(predictions: tuple[RivalForecast, ...], weight: Array) -> tuple[float, list[tuple[int, int]]]:
    """Mutual information of candidates of probability `weight` and outcome, bits, and pairs (i, j) that would be told apart."""
    rng, draws = np.random.default_rng(4711), 60
    outcomes = [p.mean + rng.normal(size=(draws, len(p.mean))) @ p.factor.T for p in predictions]
    # (i, j, draws) of outcomes drawn from candidate i, under candidate j
    log_density = np.array([[q.log_density(own) for q in predictions] for own in outcomes])
    mixture, own = logsumexp(log_density + np.log(weight)[:, None], axis=1), np.einsum("iid->id", log_density)
    bits = float(weight @ (own - mixture).mean(axis=1)) / np.log(2)
    # (i, j) by which outcomes drawn from candidate i tell it from j, both as likely before
    pair_bits = 1 - np.logaddexp(0.0, log_density - own[:, None]).mean(axis=2) / np.log(2)
    separated = np.argwhere(np.triu(np.minimum(pair_bits, pair_bits.T) > SEPARATED_BITS, 1))
    return max(bits, 0.0), [(i, j) for i, j in separated.tolist()]  # the mean of few draws can fall below 0
