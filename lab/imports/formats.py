"""Files of other programs as columns of numbers, by their ending."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

from recordings.bounded import read_bounded

from ..files.config import ConfigError
from ..files.inputs import TABLES
from .arrays import read_numpy
from .c3d_files import read_c3d
from .columns import of_frame
from .map_file import Source
from .matlab import read_matlab
from .series import LARGEST, Series, cleaned, demand_bounded, demand_columns, of_judged, package
from .text_tables import read_text


def read(paths: Path | Sequence[Path], source: Source, named: Collection[str] | None = None) -> Series:
    """The columns of a file, by its ending, or of the parts of one recording; raises ConfigError.

    `named`: columns that are wanted where reading others costs much; None: all.
    """
    parts = (paths,) if isinstance(paths, Path) else paths
    path = parts[0]
    if path.suffix.lower() == RECORDING:
        from .recording_topics import read_topics

        found = read_topics(parts, source, named)
    else:
        reader = READERS.get(path.suffix.lower())
        if reader is None:
            remedy = REMEDIES.get(path.suffix.lower(), "export it as CSV")
            raise ConfigError(f"{path}: files of this kind are not read; known are {', '.join(KNOWN)}; {remedy}")
        found = reader(path, source)
    found = cleaned(found, source.missing)
    if not len(found):
        raise ConfigError(f"{path}: has no rows of numbers")
    demand_columns(path, len(found.names))
    return found


def _parquet(path: Path, source: Source) -> Series:
    parquet = package("pyarrow.parquet", path)
    read_bounded(path, LARGEST, ConfigError)
    try:
        about = parquet.read_metadata(path)
        groups = [about.row_group(g) for g in range(about.num_row_groups)]
        values = sum(group.column(c).num_values for group in groups for c in range(group.num_columns))
        # before anything is unpacked: a value that repeats takes no bytes
        demand_bounded(path, max(8 * values, sum(group.total_byte_size for group in groups)))
        table = parquet.read_table(path)
    except ConfigError:
        raise
    except Exception as e:
        raise ConfigError(f"{path}: is not a Parquet file ({type(e).__name__}: {str(e).splitlines()[0][:200]})") from e
    return of_judged(path, {n: of_frame(table[n].to_pandas(), source.missing) for n in table.column_names}, "Parquet")


READERS: Mapping[str, Callable[[Path, Source], Series]] = dict.fromkeys(TABLES, read_text) | {
    ".mat": read_matlab, ".npz": read_numpy, ".npy": read_numpy, ".c3d": read_c3d, ".parquet": _parquet,
}  # fmt: skip
"""By ending."""
RECORDING = ".mcap"
REMEDIES: Mapping[str, str] = dict.fromkeys((".zstd", ".zst", ".lz4", ".gz", ".zip"), "unpack it first") | dict.fromkeys(
    (".bag", ".db3"), "convert it with `mcap convert`"
)
""".. by ending, where a table is not the remedy."""
KNOWN = (*READERS, RECORDING)
