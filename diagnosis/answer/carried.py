"""The budget of the answer, in mm: what is named, what is present beside it, and what these data could not show."""

from __future__ import annotations

from ..judgement import PRESENT_FLOORS
from .attribute import Attribution
from .distinguishability import visible
from .result import Carries

INTERVAL = (0.025, 0.5, 0.975)


def carried(f: Attribution) -> tuple[Carries, ...]:
    """Largest first within named, present and unseen."""
    p = f.prepared.problem.parameters
    c = f.best
    linear = c.linear(f.prepared.problem)
    reduced = linear.reduced(c.grid_point.size, c.grid_point.form_error)
    seen = visible(reduced, p, p.ids, c.grid_point.spike, linear.effect_size)
    floor = 1e3 * (f.prepared.pushes.noise_floor if f.prepared.pushes and f.prepared.pushes_only else f.prepared.noise_floor)
    out = []
    for effect in p.ids:
        low, middle, high = (x * 1e3 for x in f.budget.interval(effect, *INTERVAL))
        if effect in f.decision.effects:
            out.append(Carries(effect, "named", middle, low, high))
        elif effect not in seen:
            out.append(Carries(effect, "unseen", middle, low, high))
        elif middle > PRESENT_FLOORS * floor:
            out.append(Carries(effect, "present", middle, low, high))
    order = ("named", "present", "unseen")
    return tuple(sorted(out, key=lambda x: (order.index(x.role), -x.mm)))
