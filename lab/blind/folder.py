"""The files of a blind set: commitment, seal, cases, answers."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config import ConfigError
from .truth import Truth


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
            raise ConfigError(f"{self.root}: holds no cases/<id>/trials.csv; make a set with `lab blind make`")
        return found

    def public(self) -> dict[str, Any]:
        """The commitment; raises ConfigError when it is missing or damaged."""
        return _read(self.commitment, "make a set with `lab blind make`")


def seal(folder: SetFolder, truths: Sequence[Truth], seed: int, about: dict[str, Any]) -> str:
    """Write the truth with a salt, then its digest where everybody sees it; returns the digest.

    The salt keeps a digest from being found by trying every seed.
    """
    text = json.dumps({"salt": secrets.token_hex(16), "seed": seed, "truths": [t.as_dict() for t in truths]}, indent=1)
    folder.seal.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(folder.seal, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with open(handle, "w", encoding="utf-8") as file:
        file.write(text)
    digest = hashlib.sha256(text.encode()).hexdigest()
    public = {"schema": "blind/1", "sha256_of_truth": digest, "cases": len(truths), **about,
              "made": time.strftime("%Y-%m-%d %H:%M:%S")}  # fmt: skip
    folder.commitment.write_text(json.dumps(public, indent=1) + "\n", encoding="utf-8")
    return digest


def open_seal(folder: SetFolder) -> dict[str, dict[str, Any]]:
    """The truth by case; raises ConfigError when it is not the text whose digest was committed to."""
    promised = folder.public().get("sha256_of_truth")
    try:
        text = folder.seal.read_text(encoding="utf-8")
    except OSError as e:
        raise ConfigError(f"{folder.seal}: cannot be read ({e.strerror}); a set is scored where its seal is") from e
    found = hashlib.sha256(text.encode()).hexdigest()
    if found != promised:
        raise ConfigError(
            f"{folder.seal}: sha256 {found} is not the {promised} of {folder.commitment.name}; "
            "the truth was changed after it was committed to, nothing is scored"
        )
    return {t["case"]: t for t in json.loads(text)["truths"]}


def _read(path: Path, hint: str) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as e:
        raise ConfigError(f"{path}: cannot be read ({e.strerror}); {hint}") from e
    except ValueError as e:
        raise ConfigError(f"{path}: is not JSON ({e}); {hint}") from e
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: holds no table; {hint}")
    return data
