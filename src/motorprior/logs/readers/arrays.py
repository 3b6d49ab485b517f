"""Files of named arrays, read by a column map: PyTorch (.pt), NumPy (.npz, .npy), MATLAB (.mat), pickles (.pkl).

A column is an array ``x`` (T,), or column 2 of an array (T, J), ``x[2]``. Arrays in tables and
lists have names with dots, such as ``run.0.joint_pos``; the last part is enough where it is the
only such name. A list with a table of arrays per step is stacked. Nothing in a file is executed.
The array of a .npy is ``data``.
"""

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_bytes, require_file
from motorprior.exceptions import LogError, quoted
from motorprior.logs.column_map import ColumnMap
from motorprior.logs.log_reader import LogReader
from motorprior.logs.motor_log import CORRECT, missing_column, unreadable
from motorprior.logs.pickles import load_pickle, require_archive_size, torch_content
from motorprior.logs.readers.table import element_of

_MAX_PARTS = 100  # maximum length of a list whose items are separate arrays


def array_columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    """Name of a column -> (T,) float64; raises LogError for a damaged file, or a name that has no column."""
    arrays = _arrays(path)
    found = {}
    for name in names:
        key, index = element_of(name)
        ends = [known for known in arrays if known.endswith(f".{key}")]
        values = arrays.get(key, arrays[ends[0]] if len(ends) == 1 else None)
        if values is None:
            raise missing_column("array", key, arrays, path)
        table = values[:, None] if values.ndim == 1 else values
        if (
            table.ndim != 2
            or (index or 0) >= table.shape[1]
            or (index is None and table.shape[1] > 1)
        ):
            raise LogError(
                f"{name}: the array has shape {values.shape}", where=path, remedy=CORRECT
            )
        found[name] = table[:, index or 0].astype(np.float64)
    lengths = {name: len(column) for name, column in found.items()}
    if len(set(lengths.values())) > 1:
        raise LogError(
            f"columns of different lengths: {quoted(lengths, 200)}", where=path, remedy=CORRECT
        )
    return found


def _unmapped(path: Path) -> str:
    shapes = [f"{quoted(key, 60)} {value.shape}" for key, value in _arrays(path).items()]
    return f"arrays without a map: {', '.join(shapes[:8]) or 'none'}"


def _arrays(path: Path) -> dict[str, np.ndarray]:
    require_file(path, LogError)
    try:
        content = _CONTENT[path.suffix](path)
    except LogError:
        raise
    except Exception as error:  # damaged files raise many types
        raise unreadable(path, error) from error
    found: dict[str, np.ndarray] = {}
    _collect("", content, found)
    return found


def _collect(name: str, value: Any, found: dict[str, np.ndarray]) -> None:
    """Add the arrays in a value to ``found``, by names that begin with ``name``."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        value = {field: value[field] for field in value.dtype.names}
    if isinstance(value, Mapping):
        for key, each in value.items():
            _collect(f"{name}.{key}".removeprefix("."), each, found)
    elif isinstance(value, list | tuple) and len(value) > 1 and _same_keys(value):
        for key in value[0]:
            _collect(f"{name}.{key}".removeprefix("."), [step[key] for step in value], found)
    elif isinstance(value, list | tuple | np.ndarray):
        try:
            array = np.asarray(value)
        except ValueError:  # of different lengths
            array = np.zeros((), object)
        if array.dtype.kind in "biuf" and array.ndim:
            found[name or "data"] = array
        elif isinstance(value, list | tuple) and len(value) <= _MAX_PARTS:
            for index, each in enumerate(value):
                _collect(f"{name}.{index}".removeprefix("."), each, found)


def _same_keys(tables: Sequence[Any]) -> bool:
    return all(
        isinstance(each, Mapping) and each and each.keys() == tables[0].keys() for each in tables
    )


def _numpy(path: Path) -> Any:
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            require_archive_size(archive, path)
    elif path.suffix == ".npz":  # numpy would take it for a pickle
        raise LogError("not an archive of NumPy", where=path, remedy="write it with numpy.savez")
    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return loaded
    found = {}
    for name in loaded.files:
        try:
            found[name] = loaded[name]
        except ValueError as error:
            if "Object arrays" not in str(error):  # these would have to be unpickled
                raise
    return found


def _matlab(path: Path) -> Any:
    from scipy.io import loadmat  # takes half a second

    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError as error:  # of version 7.3, which is HDF5
        problem = "a MATLAB file of version 7.3"
        remedy = 'save it by save(…, "-v7")'
        raise LogError(problem, where=path, remedy=remedy) from error
    return {key: value for key, value in content.items() if not key.startswith("__")}


_CONTENT = {
    ".pt": torch_content, ".npz": _numpy, ".npy": _numpy, ".mat": _matlab,
    **dict.fromkeys((".pkl", ".pickle"), lambda path: load_pickle(read_bytes(path, LogError), where=path)),
}  # fmt: skip
READER = LogReader("arrays", tuple(_CONTENT), columns=array_columns, unmapped=_unmapped)
