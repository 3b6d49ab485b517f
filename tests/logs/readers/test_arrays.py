"""Arrays of NumPy, MATLAB and pickles are read by a column map; a missing array is named."""

import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from motorprior.artifacts import MAX_BYTES
from motorprior.exceptions import LogError
from motorprior.logs.column_map import ColumnMap, load_column_map
from motorprior.logs.read_log import read_log

ROWS = 50
TARGET = 0.3 * np.sin(0.1 * np.outer(np.arange(ROWS), [1.0, 2.0]))
ANGLE = np.roll(TARGET, 2, axis=0)


@pytest.fixture
def columns(tmp_path: Path) -> ColumnMap:
    lines = (
        'motor = "m"\nrate = 50\nposition_target = "q_des[{joint}]"\njoint_pos = "q[{joint}]"\n'
        "[joints.0]\n[joints.1]\n"
    )
    (tmp_path / "map.toml").write_text(lines)
    return load_column_map(tmp_path / "map.toml")


def written(folder: Path, ending: str) -> Path:
    arrays = {"q": ANGLE, "q_des": TARGET}
    path = folder / f"log{ending}"
    steps = [{"q": ANGLE[row], "q_des": TARGET[row]} for row in range(ROWS)]

    if ending == ".npz":
        np.savez(path, note=np.array("text"), **arrays)  # pyright: ignore[reportArgumentType]
    elif ending == ".mat":
        savemat(path, {"run": arrays})
    elif ending == ".npy":
        np.save(path, np.concatenate([ANGLE, TARGET], axis=1))
    elif ending == ".pkl":
        path.write_bytes(pickle.dumps({"closed_loop": [{}, steps]}))
    else:
        path.write_bytes(pickle.dumps(arrays))

    return path


@pytest.mark.parametrize("ending", [".npz", ".mat", ".pkl", ".pickle"])
def test_arrays_of_any_container_become_a_log(tmp_path: Path, columns: ColumnMap, ending: str):
    log = read_log(written(tmp_path, ending), columns=columns)

    np.testing.assert_allclose(log.joint_pos, ANGLE)
    np.testing.assert_allclose(log.position_target, TARGET)
    with pytest.raises(LogError, match=r"'.*q' \(50, 2\)"):
        read_log(written(tmp_path, ending))


def test_a_single_array_is_called_data(tmp_path: Path):
    lines = (
        'motor = "m"\nrate = 50\nposition_target = "data[3]"\njoint_pos = "data[1]"\n[joints.0]\n'
    )
    (tmp_path / "map.toml").write_text(lines)
    log = read_log(written(tmp_path, ".npy"), columns=tmp_path / "map.toml")

    np.testing.assert_array_equal(log.joint_pos[:, 0], ANGLE[:, 1])


def test_a_missing_array_and_different_lengths_are_refused(tmp_path: Path, columns: ColumnMap):
    np.savez(tmp_path / "log.npz", q=ANGLE, q_des=TARGET[:-1])

    with pytest.raises(LogError, match="lengths"):
        read_log(tmp_path / "log.npz", columns=columns)

    np.savez(tmp_path / "log.npz", q=ANGLE)

    with pytest.raises(LogError, match=r"'q_des'.*'q'"):
        read_log(tmp_path / "log.npz", columns=columns)


@pytest.mark.parametrize("name", ["log.npz", "log.pt"])
def test_an_archive_that_unpacks_to_more_than_the_bound_is_not_read(
    tmp_path: Path, columns: ColumnMap, name: str
):
    with zipfile.ZipFile(tmp_path / name, "w") as archive:
        archive.writestr("log/data.pkl", b"")
        archive.infolist()[0].file_size = MAX_BYTES + 1

    with pytest.raises(LogError, match=str(MAX_BYTES)) as refused:
        read_log(tmp_path / name, columns=columns)
    assert refused.value.where == tmp_path / name
