"""The project's own fake instruments, by the name of their driver.

A package announces one, an `instrument.Fake`, as an entry point of the group `softlab.fakes`, under the name of the driver
that it announces in `softlab.drivers`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

from .alicat import AlicatFake
from .drum import METRES_PER_TURN
from .dynamixel import DynamixelFake
from .ft300s import Ft300sFake
from .instrument import Fake, Site
from .motive import MOCAP_TO_BASE, MotiveFake
from .numato import NumatoFake
from .pfeiffer import PfeifferFake
from .pty_fake import PtyFake
from .smc_itv import SmcItvFake
from .tmcl import TmclFake
from .ur.process import UrFake

GROUP = "softlab.fakes"
LETTERS = "ABCDEFGHI"


def _alicat(site: Site) -> list[PtyFake]:
    how, units = site.regulators, LETTERS[: len(site.hoses)]
    made = partial(AlicatFake, seed=site.seed, full_scale=site.full_scale, firmware=how.firmware, unit=how.unit)
    return [made(site.plant, site.clock, units, site.hoses)]


def _alicat_table(site: Site, lines: Sequence[PtyFake]) -> dict[str, Any]:
    return {"port": lines[0].port, "units": list(LETTERS[: len(site.hoses)]), "unit": site.regulators.unit}


def _smc_itv(site: Site) -> list[PtyFake]:
    return [
        SmcItvFake(site.plant, site.clock, chambers=group, seed=site.seed + 5 + i, full_scale=site.full_scale)
        for i, group in enumerate(site.hoses)
    ]


def _ports(site: Site, lines: Sequence[PtyFake]) -> dict[str, Any]:
    return {"ports": [line.port for line in lines]}


def _port(site: Site, lines: Sequence[PtyFake]) -> dict[str, Any]:
    return {"port": lines[0].port}


def _length_unit(site: Site, lines: Sequence[PtyFake]) -> dict[str, Any]:
    return {"port": lines[0].port, "metres_per_turn": METRES_PER_TURN}


def _natnet(site: Site, parts: Sequence[MotiveFake]) -> dict[str, Any]:
    return {
        "server": site.host,
        "body": "Tip",
        "markers": [f"M{i + 1}" for i in range(site.markers)],
        "mocap_to_base": {"position": list(MOCAP_TO_BASE[0]), "quaternion": list(MOCAP_TO_BASE[1])},
    }


OWN: Mapping[str, Fake] = MappingProxyType(
    {
        "ur5": Fake("arm", lambda s: [UrFake(s.plant, s.clock, s.host, s.seed)], lambda s, parts: {"host": s.host}),
        "natnet": Fake("mocap", lambda s: [MotiveFake(s.plant, s.clock, s.host, markers=s.markers, seed=s.seed)], _natnet),
        "ft300s": Fake("force", lambda s: [Ft300sFake(s.plant, s.clock, seed=s.seed)], _port),
        "alicat": Fake("pressure", _alicat, _alicat_table, full_scale=400e3),
        "smc_itv": Fake("pressure", _smc_itv, _ports),
        "dynamixel": Fake("spine", lambda s: [DynamixelFake(s.plant, s.clock, seed=s.seed)], _length_unit),
        "tmcl": Fake("spine", lambda s: [TmclFake(s.plant, s.clock, seed=s.seed)], _length_unit),
        "numato": Fake("valve", lambda s: [NumatoFake(s.plant, s.clock, seed=s.seed)], _port),
        "pfeiffer": Fake("gauge", lambda s: [PfeifferFake(s.plant, s.clock, seed=s.seed)], _port),
    }
)


def of_role(role: str, known: Mapping[str, Fake] = OWN) -> tuple[str, ...]:
    """The names of the fakes of one key in rig.yaml."""
    return tuple(name for name, fake in known.items() if fake.role == role)
