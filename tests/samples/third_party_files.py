"""Small files in the formats of other projects, made from one known motion."""

import gzip
import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

ROWS = 40
JOINTS = ("pan", "lift")
TIME = 0.02 * np.arange(ROWS)
TARGET = np.stack([np.sin(3.0 * TIME), 0.5 * np.cos(2.0 * TIME)], axis=1)
ANGLE = np.stack([np.sin(3.0 * (TIME - 0.05)), 0.5 * np.cos(2.0 * (TIME - 0.05))], axis=1)
TENSOR_MAP = """
motor = "servo"
time = "time"
position_target = "des_dof_pos[{joint}]"
joint_pos = "dof_pos[{joint}]"

[joints]
0 = { name = "pan" }
1 = { name = "lift" }
"""


def csv_columns(num_joints: int) -> tuple[str, ...]:
    """Columns of the CSV of jietan/puppersim: time, targets, angles, IMU."""
    joints = [f"{name}_{joint}" for name in ("q_des", "q") for joint in range(num_joints)]
    return ("t_s", *joints, "imu_roll", "imu_pitch", "imu_rate_roll", "imu_rate_pitch")


def write_bam(folder: Path, **changes: Any) -> Path:
    """Path of a recording of the pendulum of BAM; ``changes`` are keys of the file."""
    entries = []
    for row in range(ROWS):
        entry = {
            "timestamp": float(TIME[row]),
            "goal_position": float(TARGET[row, 0]),
            "position": float(ANGLE[row, 0]),
            "speed": 0.0,
            "torque_enable": True,
            "load": 65535,
        }
        entries.append(entry)

    whole = {
        "mass": 0.5,
        "length": 0.1,
        "kp": 100,
        "vin": 7.4,
        "motor": "xl330",
        "entries": entries,
    } | changes
    path = folder / "swing.json.gz"
    path.write_bytes(gzip.compress(json.dumps(whole).encode()))
    return path


def write_sage(folder: Path, control_late: float = 0.0) -> Path:
    """Path of a recording of SAGE whose commands have time stamps that are late [s]."""
    path = folder / "motion"
    path.mkdir(exist_ok=True)
    (path / "joint_list.txt").write_text("\n".join(JOINTS) + "\n")

    controls = [
        f'CONTROL,{1e6 * (t + control_late)},"{g}"'
        for t, g in zip(TIME, TARGET.tolist(), strict=True)
    ]
    (path / "control.csv").write_text("\n".join(["type,timestamp,positions", *controls]) + "\n")

    zeros = [0.0] * len(JOINTS)
    states = [
        f'STATE_MOTOR,{1e6 * t},"{q}","{zeros}","{zeros}"'
        for t, q in zip(TIME, ANGLE.tolist(), strict=True)
    ]
    header = "type,timestamp,positions,velocities,torques"
    (path / "state_motor.csv").write_text("\n".join([header, *states]) + "\n")
    return path


def write_lerobot(folder: Path) -> Path:
    """Path of a LeRobot dataset with two episodes, in degrees."""
    path = folder / "dataset"
    (path / "meta").mkdir(parents=True, exist_ok=True)
    (path / "data" / "chunk-000").mkdir(parents=True, exist_ok=True)

    feature = {"dtype": "float32", "shape": [2], "names": [f"{joint}.pos" for joint in JOINTS]}
    features = {"action": feature, "observation.state": feature}
    info = {"codebase_version": "v3.0", "robot_type": "arm", "fps": 50.0, "features": features}
    (path / "meta" / "info.json").write_text(json.dumps(info))

    half = ROWS // 2
    table = {
        "action": list(np.rad2deg(TARGET).astype(np.float32)),
        "observation.state": list(np.rad2deg(ANGLE).astype(np.float32)),
        "timestamp": np.tile(TIME[:half], 2).astype(np.float32),
        "episode_index": np.repeat([0, 1], half),
    }
    for index, rows in enumerate((slice(0, half), slice(half, ROWS))):
        part = pa.table({name: values[rows] for name, values in table.items()})
        pq.write_table(part, path / "data" / "chunk-000" / f"file-{index:03d}.parquet")
    return path


def write_csv(folder: Path, suffix: str = "csv") -> Path:
    """Path of a table, with its column map beside it."""
    (folder / "columns.toml").write_text(TENSOR_MAP.replace("[{joint}]", "_{joint}"))
    series = {"des_dof_pos": TARGET, "dof_pos": ANGLE}
    columns = {"time": TIME}
    for name, values in series.items():
        for joint in range(len(JOINTS)):
            columns[f"{name}_{joint}"] = values[:, joint]
    table = pa.table(columns)

    path = folder / f"log.{suffix}"
    if suffix == "parquet":
        pq.write_table(table, path)
    else:
        pa_csv.write_csv(table, path)
    return path


def write_parquet(folder: Path) -> Path:
    return write_csv(folder, "parquet")


class Storage:
    """Pickles as the reference by which torch.save names the numbers of a storage."""

    def __init__(self, type_name: str, key: str, count: int):
        self.reference = ("storage", Name("torch", type_name), key, "cpu", count)


class Name:
    """Pickles as a global."""

    def __init__(self, module: str, name: str):
        self.module = module
        self.name = name

    def __reduce__(self) -> str:
        return self.name


class Tensor:
    """Pickles as `_rebuild_tensor_v2` of torch."""

    def __init__(
        self, storage: Storage, offset: int, size: tuple[int, ...], stride: tuple[int, ...]
    ):
        self.call = (storage, offset, size, stride, False, {})


# Only the pickler written in Python can write any global.
_PICKLER: Any = getattr(pickle, "_Pickler")  # noqa: B009


class TensorPickler(_PICKLER):
    """Writes what torch.save writes, without torch."""

    def persistent_id(self, obj: Any) -> Any:
        return obj.reference if isinstance(obj, Storage) else None

    def save(self, obj: Any, save_persistent_id: bool = True) -> None:
        if isinstance(obj, Name):
            self.write(f"c{obj.module}\n{obj.name}\n".encode())
        elif isinstance(obj, Tensor):
            self.write(b"ctorch._utils\n_rebuild_tensor_v2\n")
            super().save(obj.call)
            self.write(pickle.REDUCE)
        else:
            super().save(obj, save_persistent_id)


def write_tensors(path: Path, content: dict[str, Any], storages: dict[str, bytes]) -> Path:
    """Path of a file of torch.save with these contents and numbers of storages."""
    stream = io.BytesIO()
    TensorPickler(stream, 2).dump(content)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("log/data.pkl", stream.getvalue())
        archive.writestr("log/byteorder", "little")
        for key, raw in storages.items():
            archive.writestr(f"log/data/{key}", raw)
    return path


def write_pt(folder: Path) -> Path:
    """Path of a file of tensors, with its column map beside it."""
    arrays = {"time": TIME, "des_dof_pos": TARGET, "dof_pos": np.asfortranarray(ANGLE)}
    content = {}
    storages = {}
    for index, (name, array) in enumerate(arrays.items()):
        raw = array.astype("<f4").tobytes(order="A")
        stride = tuple(step // array.itemsize for step in array.strides)
        storage = Storage("FloatStorage", str(index), array.size)
        content[name] = Tensor(storage, 0, array.shape, stride)
        storages[str(index)] = raw

    (folder / "columns.toml").write_text(TENSOR_MAP)
    return write_tensors(folder / "log.pt", content, storages)
