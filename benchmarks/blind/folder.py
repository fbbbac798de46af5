"""The files of a blind set: commitment, seal, cases, answers."""

from __future__ import annotations

import hashlib
import json
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lab.files.config import ConfigError
from recordings.bounded import read_bounded
from recordings.json_text import read_json
from recordings.own_files import replaced

from .truth import Truth

LARGEST = 20_000_000
"""Bytes of a JSON file of a set."""


@dataclass(frozen=True)
class SetFolder:
    """Where things are in a set."""

    root: Path

    @property
    def commitment(self) -> Path:
        """Public: what the set is, and the digest of its truth."""
        return self.root / "commitment.json"

    @property
    def seal(self) -> Path:
        """The truth; `score` alone reads it."""
        return self.root / "sealed" / "truth.json"

    @property
    def score(self) -> Path:
        """What the score came to."""
        return self.root / "score.json"

    def case(self, name: str) -> Path:
        """A case folder."""
        return self.root / "cases" / name

    def answers(self, name: str) -> Path:
        """Where a case's answers go."""
        return self.root / "answers" / name

    def names(self) -> list[str]:
        """The cases of the set; raises ConfigError when there is none."""
        found = sorted(p.parent.name for p in (self.root / "cases").glob("*/trials.csv"))
        if not found:
            raise ConfigError(f"{self.root}: holds no cases/<id>/trials.csv; make a set with `python -m benchmarks.blind make`")
        return found

    def public(self) -> dict[str, Any]:
        """The commitment; raises ConfigError when it is missing or damaged."""
        return _read(self.commitment, "make a set with `python -m benchmarks.blind make`")


def new_set(root: Path) -> SetFolder:
    """The folder of a set that is to be made; raises ConfigError when something is in it."""
    if root.exists() and any(root.iterdir()):
        raise ConfigError(f"{root}: is not empty; give each set a new folder, so that no truth is drawn twice")
    return SetFolder(root)


def seal(folder: SetFolder, truths: Sequence[Truth], seed: int, about: dict[str, Any]) -> str:
    """Write the truth with a salt, then its digest where everybody sees it; returns the digest.

    The salt keeps a digest from being found by trying every seed.
    """
    text = json.dumps({"salt": secrets.token_hex(16), "seed": seed, "truths": [t.as_dict() for t in truths]}, indent=1)
    folder.seal.parent.mkdir(parents=True, exist_ok=True)
    replaced(folder.seal, text, 0o600)
    digest = hashlib.sha256(text.encode()).hexdigest()
    public = {"schema": "blind/1", "sha256_of_truth": digest, "cases": len(truths), **about,
              "made": time.strftime("%Y-%m-%d %H:%M:%S")}  # fmt: skip
    replaced(folder.commitment, json.dumps(public, indent=1) + "\n")
    return digest


def open_seal(folder: SetFolder) -> dict[str, dict[str, Any]]:
    """The truth by case; raises ConfigError when it is not the text whose digest was committed to."""
    promised = folder.public().get("sha256_of_truth")
    try:
        data = read_bounded(folder.seal, LARGEST, ConfigError)
    except ConfigError as e:
        raise ConfigError(f"{e}; score a set in the folder that has its seal") from e
    found = hashlib.sha256(data).hexdigest()
    if found != promised:
        raise ConfigError(
            f"{folder.seal}: sha256 {found} is not the {promised} of {folder.commitment.name}; "
            "the truth was changed after it was committed to, nothing is scored"
        )
    try:
        return {str(t["case"]): _truth(t) for t in read_json(data)["truths"]}
    except (ValueError, KeyError, TypeError) as e:
        raise ConfigError(f"{folder.seal}: holds no truths ({repr(e)[:200]}); nothing is scored") from e


def _truth(t: dict[str, Any]) -> dict[str, Any]:
    """One truth, with a kind and the sizes of its effects."""
    sizes = {str(name): float(size) for name, size in dict(t["effects"]).items()}
    return {**t, "kind": str(t["kind"]), "effects": sizes}


def read_table(path: Path, hint: str) -> Any:
    """What a JSON file of a set holds; ConfigError, with what to do, when it holds nothing of that kind."""
    try:
        return read_json(read_bounded(path, LARGEST, ConfigError))
    except ConfigError as e:
        raise ConfigError(f"{e}; {hint}") from e
    except ValueError as e:
        raise ConfigError(f"{path}: is not JSON ({str(e)[:200]}); {hint}") from e


def _read(path: Path, hint: str) -> dict[str, Any]:
    data = read_table(path, hint)
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: holds no table; {hint}")
    return data
