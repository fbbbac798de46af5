"""The host's time and all that waits on it: one clock for drivers, fakes, guard, rig and protocols.

A program runs on the host's own clock. `SimulatedClock` replaces it for the threads that live in it: its time stands still
while any of them computes, and jumps to the earliest deadline when all of them wait. What a thread makes here (`Event`,
`Lock`, `Thread` ...) belongs to the clock that the thread lives in.
"""

from .clock import (
    Clock,
    Condition,
    Event,
    Host,
    Lock,
    Queue,
    RigClock,
    RLock,
    Thread,
    now,
    readable,
    receive,
    recv,
    sleep,
    together,
    wait,
)
from .simulated import Deadlock, SimulatedClock

__all__ = [
    "Clock",
    "Condition",
    "Deadlock",
    "Event",
    "Host",
    "Lock",
    "Queue",
    "RLock",
    "RigClock",
    "SimulatedClock",
    "Thread",
    "now",
    "readable",
    "receive",
    "recv",
    "sleep",
    "together",
    "wait",
]
