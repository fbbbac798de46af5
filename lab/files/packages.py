"""Read entry points of installed packages and a lab's own Python files, for drivers, fakes, protocols and effects alike.

A package announces objects by name as entry points of a group. A broken package affects only its own names, and the reason is
reported where such a name is used. A name of the project's own stays the project's; of two packages that announce one name
neither is used.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import sys
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, Generic, TypeVar

from model.errors import alike
from recordings.bounded import read_bounded

from .config import ConfigError

T = TypeVar("T")
Unpack = Callable[[str, object], Mapping[str, T]]
"""What an entry point of this name gives, by name; raises `Unusable`."""


REMEDY = "repair it or remove it: pip uninstall "


class Unusable(ValueError):
    """The announced object does not fit its group; the message lists all faults."""


@dataclass(frozen=True)
class Registered(Generic[T]):
    """What can be used, by name, and what is to be said of the rest."""

    usable: Mapping[str, T]
    broken: Mapping[str, str]
    """Names that packages announce and that cannot be used: which package, what is wrong, what to do."""
    doubts: Mapping[str, str]
    """Usable names that another package also announces, in vain: the same."""


def installed(
    group: str, ours: Mapping[str, T], unpack: Unpack[T], missing: Mapping[str, str] = MappingProxyType({})
) -> Registered[T]:
    """The project's own objects and those of installed packages; `missing`: own ones that cannot be used here, and why."""
    offers: dict[str, list[tuple[str, str, str, T]]] = {}  # by name: entry point, its package and version, what it offers
    faults: dict[str, list[str]] = {}
    for point in importlib.metadata.entry_points(group=group):
        about = point.dist
        package, version = (about.name, about.version) if about else ("of unknown name", "")
        entry = f"package {package} {version}: entry point {point.name} = {point.value} of {group}"
        try:
            things = unpack(point.name, point.load())
        except Unusable as error:
            faults.setdefault(point.name, []).append(f"{entry}: {error}; {REMEDY}{package}")
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever a package of others raises must not keep a rig from landing
            why = f"{entry}: cannot be loaded: {type(error).__name__}: {error}; {REMEDY}{package}"
            faults.setdefault(point.name, []).append(why)
        else:
            for name, thing in things.items():
                offers.setdefault(name, []).append((entry, package, version, thing))
    usable, broken, doubts = dict(ours), dict(missing), {}
    for name in {**offers, **faults}:  # who has each: the project, else the one package that offers it
        offered, wrong = offers.get(name, []), faults.get(name, [])
        if name in ours or name in missing:
            why = f"the name {name} belongs to this software and cannot be replaced; {REMEDY}"
            doubts[name] = "\n".join([*(f"{entry}: {why}{package}" for entry, package, *_ in offered), *wrong])
        elif len(offered) == 1:
            usable[name] = offered[0][-1]
            if wrong:
                doubts[name] = "\n".join(wrong)
        elif offered:  # chance would decide which is used
            offered.sort(key=lambda one: one[0])
            packages = " and ".join(f"{package} {version}" for _, package, version, _ in offered)
            each = " or ".join(f"pip uninstall {p}" for p in dict.fromkeys(package for _, package, *_ in offered))
            broken[name] = f"packages {packages} both register {name}, so neither is used; keep one: {each}"
        else:
            broken[name] = "\n".join(wrong)
    return Registered(MappingProxyType(usable), MappingProxyType(broken), MappingProxyType(doubts))


def without(faults: Callable[[object], str]) -> Unpack[Any]:
    """The object of an entry point, unless it has `faults`."""

    def unpack(name: str, thing: object) -> dict[str, object]:
        if wrong := faults(thing):
            raise Unusable(wrong)
        return {name: thing}

    return unpack


def told_at(error: BaseException, file: str | Path, hint: str = "") -> str:
    """What went wrong in a Python file: its line, the function and the error, and below that the line's text."""
    where, text = f"{file}: cannot be run", ""
    for at in traceback.extract_tb(error.__traceback__):
        if at.filename == os.fspath(file):
            where = f"{file}:{at.lineno}: {'cannot be run' if at.name == '<module>' else at.name}"
            text = f"\n    {at.line}"
    return f"{where}: {type(error).__name__}: {error}{hint}{text}"


def python_file(path: Path) -> tuple[ModuleType, bytes]:
    """A Python file, run, and its text as it was run; raises ConfigError when it cannot be.

    It is no module that others can import: what is sent elsewhere from it goes as a whole (cloudpickle), not by its name."""
    spec = importlib.util.spec_from_file_location(f"softlab_file_{path.stem}", path)
    if not path.exists():
        near = alike(path.name, [other.name for other in path.parent.glob("*.py")])
        raise ConfigError(f"{path}: no such file" + (f"; did you mean {path.with_name(near)}?" if near else ""))
    if spec is None or not path.is_file():
        raise ConfigError(f"{path}: is not a readable Python file")
    text = read_bounded(path, 2_000_000, ConfigError)  # bytes
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where the annotations of its classes are looked up
    try:
        exec(compile(text, path, "exec"), module.__dict__)  # not by its loader, which would read it again, or an older one
    except (Exception, SystemExit) as error:
        raise ConfigError(told_at(error, path)) from error
    finally:
        del sys.modules[spec.name]
    return module, text
