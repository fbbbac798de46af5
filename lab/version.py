"""Which version of the software this is."""

from __future__ import annotations

import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

NAME = "softlab"


def installed(package: str = NAME) -> str:
    """The version of an installed package."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def source() -> dict[str, str]:
    """Commit of this software and whether its files were changed; empty where it was installed without git."""
    folder = Path(__file__).parent

    def ask(*arguments: str) -> str:
        try:
            done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, timeout=5, check=True)
        except (OSError, subprocess.SubprocessError):
            return ""
        return done.stdout.strip()

    return {
        "commit": ask("rev-parse", "HEAD"),
        "changed": "yes" if ask("status", "--porcelain", "--untracked-files=no") else "no",
    }


def version_text() -> str:
    """For people: version, and where it comes from a checkout the commit."""
    git = source()
    if not git["commit"]:
        return f"{NAME} {installed()}"
    return f"{NAME} {installed()} ({git['commit'][:12]}{', changed' if git['changed'] == 'yes' else ''})"
