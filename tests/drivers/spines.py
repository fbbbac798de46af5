"""Length units of both makers on their fakes, and how their tests watch them."""

from collections.abc import Callable
from typing import Any

import timing
from drivers.dynamixel import driver as dynamixel
from drivers.errors import DeviceFault
from drivers.interfaces import SpineSample
from drivers.tmcl import driver as tmcl
from sim_fakes.dynamixel import DynamixelFake
from sim_fakes.tmcl import TmclFake
from tests.simulated.bench import Bench, raises

DRIVERS: dict[str, tuple[Any, Any, Any]] = {
    "dynamixel": (dynamixel.DynamixelSpine, dynamixel.Config, DynamixelFake),
    "tmcl": (tmcl.TmclSpine, tmcl.Config, TmclFake),
}
Make = Callable[..., tuple[Any, Any]]


def make_pair(bench: Bench, kind: str, fake: dict[str, Any] | None = None, **changes: Any) -> tuple[Any, Any]:
    """A driver with other settings in rig.yaml, and its fake with other options; neither is opened."""
    driver, config, make = DRIVERS[kind]
    unit = bench.started(make(bench.plant, bench.clock, **(fake or {})))
    values = {"port": unit.port, "metres_per_turn": 0.1, "timeout": 1.0} | changes
    return bench.closing(driver("spine", config(**values), bench.clock)), unit


def watch(unit: Any, until: Callable[[SpineSample], bool], within: float = 60.0) -> SpineSample:
    """Poll until the sample is as wanted; `within` is host time."""
    deadline = timing.now() + within
    while not until(sample := unit.read()):
        assert timing.now() < deadline, f"still {sample}"
        timing.sleep(0.01)
    return sample


def arrive(unit: Any) -> SpineSample:
    return watch(unit, lambda sample: not sample.moving)


def homed(unit: Any) -> Any:
    """The unit, opened and homed."""
    unit.open()
    unit.home()
    watch(unit, lambda sample: sample.homed)
    return unit


def under_way(unit: Any) -> Any:
    """The unit, homed and then on its way to 30 cm."""
    homed(unit).move_to(0.3, 0.02)
    watch(unit, lambda sample: sample.length > 0.02)
    return unit


def fault_of(unit: Any, words: str) -> str:
    """Poll until the unit reports a fault with these words; its message."""
    return raises(DeviceFault, words, watch, unit, lambda _: False)
