"""Execute a notebook, for the site and for the tests, without Jupyter."""

from __future__ import annotations

import ast
import contextlib
import html
import io
import json
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any


def executed(path: Path) -> tuple[str, dict[str, Any]]:
    """Return a notebook as Markdown with what its cells show, and the names it leaves; runs in a copy of the examples."""
    names: dict[str, Any] = {}
    page = []
    with TemporaryDirectory() as folder:
        shutil.copytree(path.parents[1], Path(folder) / "examples")
        with contextlib.chdir(Path(folder) / "examples" / path.parent.name):
            for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
                source = "".join(cell["source"])
                page += [source] if cell["cell_type"] != "code" else [f"```python\n{source}\n```", *_shown(source, names)]
    return "\n\n".join(page), names


def _shown(source: str, names: dict[str, Any]) -> list[str]:
    """Execute a cell; what it prints, and its value."""
    body = ast.parse(source).body
    last = body.pop() if isinstance(body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(ast.Module(body, []), "cell", "exec"), names)
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), names) if isinstance(last, ast.Expr) else None
    shown = [f"```text\n{printed.getvalue()}\n```"] if printed.getvalue() else []
    if value is not None:
        table = value._repr_html_() if hasattr(value, "_repr_html_") else f"<pre>{html.escape(repr(value))}</pre>"
        shown.append(f"```{{raw}} html\n{table}\n```")
    return shown
