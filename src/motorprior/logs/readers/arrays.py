"""Files of named arrays, read by a column map.

They are of PyTorch (.pt), NumPy (.npz, .npy), MATLAB (.mat), or pickles (.pkl). A column is an
array ``x`` (T,), or column 2 of an array (T, J), ``x[2]``. Element 2 of an array (J,), such as a
gain of a joint, is also ``x[2]``, and holds for all rows. Arrays in tables and lists have names
with dots (`named_arrays`); the last part is enough where it is the only such name. Nothing in a
file is executed. The array of a .npy is ``data``.
"""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import require_file
from motorprior.exceptions import LogError, quoted
from motorprior.logs.column_map import ColumnMap
from motorprior.logs.log_reader import LogReader
from motorprior.logs.motor_log import CORRECT, missing_column, unreadable
from motorprior.logs.named_arrays import named_arrays
from motorprior.logs.pickled_arrays import pickled_arrays
from motorprior.logs.pickles import require_archive_size
from motorprior.logs.readers.table import element_of


def array_columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    """Columns (T,) float64 by name.

    Raises:
        LogError: a damaged file, a name that has no column, or columns of different lengths.
    """
    arrays = _arrays(path)
    values = {name: _column(name, arrays, path) for name in names}
    constants = [name for name, column in values.items() if column.size == 1]
    lengths = {name: len(values[name]) for name in names if name not in constants}
    if len(set(lengths.values())) > 1:
        raise LogError(
            f"columns of different lengths: {quoted(lengths, 200)}", where=path, remedy=CORRECT
        )
    num_rows = next(iter(lengths.values()), 1)
    return values | {name: np.full(num_rows, values[name]) for name in constants}


def _column(name: str, arrays: dict[str, np.ndarray], path: Path) -> np.ndarray:
    """(T,) column, or () or (1,) for a number that holds for all rows."""
    key, index = element_of(name)
    array = arrays.get(key)
    if array is None:
        longer_names = [longer for longer in arrays if longer.endswith(f".{key}")]
        if len(longer_names) != 1:
            raise missing_column("array", key, arrays, path)
        array = arrays[longer_names[0]]

    if array.ndim == 1 and index is not None and index < len(array):
        return np.asarray(array[index], np.float64)
    if array.ndim == 0:
        return array.astype(np.float64)
    table = array[:, None] if array.ndim == 1 else array
    is_column = table.ndim == 2 and (index or 0) < table.shape[1]
    if not is_column or (index is None and table.shape[1] > 1):
        raise LogError(f"{name}: the array has shape {array.shape}", where=path, remedy=CORRECT)
    return table[:, index or 0].astype(np.float64)


def _unmapped(path: Path) -> str:
    shapes = [f"{quoted(name, 60)} {array.shape}" for name, array in _arrays(path).items()]
    return f"arrays without a map: {', '.join(shapes[:8]) or 'none'}"


def _names(path: Path) -> list[str]:
    return list(_arrays(path))


def _arrays(path: Path) -> dict[str, np.ndarray]:
    require_file(path, LogError)
    try:
        return _READ[path.suffix](path)
    except LogError:
        raise
    except Exception as error:  # damaged files raise many types
        raise unreadable(path, error) from error


def _numpy_arrays(path: Path) -> dict[str, np.ndarray]:
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            require_archive_size(archive, path)
    elif path.suffix == ".npz":  # numpy would take it for a pickle
        raise LogError("not an archive of NumPy", where=path, remedy="write it with numpy.savez")

    loaded = np.load(path, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return named_arrays(loaded)

    arrays = {}
    for name in loaded.files:
        try:
            arrays[name] = loaded[name]
        except ValueError as error:
            if "Object arrays" not in str(error):  # these would have to be unpickled
                raise
    return named_arrays(arrays)


def _matlab_arrays(path: Path) -> dict[str, np.ndarray]:
    from scipy.io import loadmat  # takes half a second

    try:
        content: dict[str, Any] = loadmat(path, simplify_cells=True)
    except NotImplementedError as error:  # of version 7.3, which is HDF5
        raise LogError(
            "a MATLAB file of version 7.3", where=path, remedy='save it by save(…, "-v7")'
        ) from error
    return named_arrays(
        {name: value for name, value in content.items() if not name.startswith("__")}
    )


_READ = {
    ".pt": pickled_arrays,
    ".npz": _numpy_arrays,
    ".npy": _numpy_arrays,
    ".mat": _matlab_arrays,
    ".pkl": pickled_arrays,
    ".pickle": pickled_arrays,
}
READER = LogReader("arrays", tuple(_READ), columns=array_columns, names=_names, unmapped=_unmapped)
