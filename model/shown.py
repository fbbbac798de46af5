"""What a notebook shows of a result: its repr in one line and a table, whose headings carry the units."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pandas import DataFrame

MOST_ROWS = 20
"""Of the table in a notebook."""


class Shown:
    """A result that becomes a DataFrame."""

    def _columns(self) -> Mapping[str, Any]:
        """Heading with unit -> values, one for each row."""
        raise NotImplementedError

    def to_frame(self) -> DataFrame:
        """The result as a pandas DataFrame; units stand in the headings or in a column of their own."""
        import pandas  # a second, which most uses do not need

        return pandas.DataFrame(dict(self._columns()))

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(repr(self).strip('<>'))}</p>{self.to_frame().to_html(max_rows=MOST_ROWS)}"


def by_axis(heading: str, vectors: Any, factor: float = 1e3, axes: str = "xyz") -> dict[str, Any]:
    """A column for each axis of vectors (n, 3) times `factor`; none where there are no vectors.

    >>> by_axis("tip {} [mm]", np.array([[0.0, 0.0, 0.4]]))["tip z [mm]"].tolist()
    [400.0]
    """
    return {} if vectors is None else {heading.format(a): factor * np.asarray(vectors)[:, k] for k, a in enumerate(axes)}
