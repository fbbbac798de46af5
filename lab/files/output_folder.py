"""Output folders: each holds the complete result of one command, and nothing else."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from .config import ConfigError

CRATE = "ro-crate-metadata.json"
"""File that shows the recordings of a folder to be copies."""
MOST_NAMED = 4
"""Number of obstructing files that are named."""


def demand_free(folder: Path | None, rewritten: Collection[str] = (), replace: bool = False, inputs: Sequence[Path] = ()) -> None:
    """Raise ConfigError if a folder holds files that would be mixed with the output or lost. None: no folder is wanted.

    `rewritten`: names that the same command writes again, whatever its inputs. `replace`: it may be replaced as a whole, unless
    it holds `inputs`, other recordings, or the folder in which the command runs."""
    if folder is None or not (path := folder.resolve()).exists():
        return
    if not path.is_dir():
        raise ConfigError(f"{folder}: is a file, not a folder; give another folder")
    held = sorted(place.name for place in path.iterdir())
    strange = [name for name in held if name not in rewritten]
    if strange and not replace:
        more = f" and {len(strange) - MOST_NAMED} more" if len(strange) > MOST_NAMED else ""
        raise ConfigError(
            f"{folder}: holds {', '.join(strange[:MOST_NAMED])}{more}, which would remain next to the new files; give another "
            "folder, or --replace to delete and replace it"
        )
    must_stay = [place for place in (*inputs, Path.cwd(), Path.home()) if path in (place.resolve(), *place.resolve().parents)]
    if held and CRATE not in held:
        must_stay += list(path.rglob("*.mcap"))[:1]
    if held and must_stay:
        raise ConfigError(f"{folder}: cannot be replaced, because that would delete {must_stay[0]}; give another folder")


def fate(path: Path) -> str:
    """Before a file is written: the word for it, `replaced` where it is there already."""
    return "replaced" if path.exists() else "written"


@contextlib.contextmanager
def whole(
    folder: Path, rewritten: Collection[str] = (), replace: bool = False, inputs: Sequence[Path] = ()
) -> Iterator[tuple[Path, str]]:
    """A new folder, see `demand_free`, that takes the place of `folder` as a whole when the block ends without error; and the
    word for that: `replaced`, or `written` where there was none with files in it."""
    demand_free(folder, rewritten, replace, inputs)
    path = folder.resolve()
    empty = path.is_dir() and not any(path.iterdir())
    word = "written" if empty else fate(path)
    new_parents = [place for place in path.parents if not place.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = (path if empty else path.parent) / f".{path.name}.{secrets.token_hex(4)}.new"
    try:
        temporary.mkdir()
        yield temporary, word
        if empty:
            for place in temporary.iterdir():
                place.rename(path / place.name)
            temporary.rmdir()
        else:
            _exchanged(temporary, path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        with contextlib.suppress(OSError):  # something else is in it
            for place in new_parents:
                place.rmdir()
        raise


def _exchanged(new: Path, path: Path) -> None:
    """Give a folder the name of another, which is deleted then."""
    if not path.exists():
        new.rename(path)
        return
    shutil.copymode(path, new)
    old = new.with_suffix(".old")
    path.rename(old)
    try:
        new.rename(path)
    except BaseException:
        old.rename(path)
        raise
    shutil.rmtree(old)


def names_apart(paths: Sequence[Path]) -> list[str]:
    """A name for each path: its stem, with folders above where several have the same. Raises ConfigError for one given twice."""
    parts = [(*path.resolve().parent.parts[1:], path.resolve().stem if path.is_file() else path.resolve().name) for path in paths]
    for k, path in enumerate(paths):
        if path.resolve() in [other.resolve() for other in paths[:k]]:
            raise ConfigError(f"{path}: is given twice")
    length = 1
    while len({part[-length:] for part in parts}) < len(parts) and length < max(map(len, parts)):
        length += 1
    several = {name for name in (part[-1] for part in parts) if sum(part[-1] == name for part in parts) > 1}
    return ["-".join(part[-length:]) if part[-1] in several else part[-1] for part in parts]
