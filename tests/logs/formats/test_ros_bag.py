"""A ROS 2 bag becomes a motor log; it needs the extra `ros`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from damaged_files import damage
from foreign_files import ANGLE, JOINTS, TARGET, TIME
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.exceptions import LogError
from motorprior.logs.formats.mcap_chunks import unpacked
from motorprior.logs.formats.registry import read_log
from motorprior.logs.motor_log import log_digest
from motorprior.pipeline.log_import.log_folder import read_log_folder

LINE = "=" * 80
DEFINITION = "\n".join(
    [
        *("std_msgs/Header header", "string[] name", "float64[] position", "float64[] velocity", "float64[] effort"),
        *(LINE, "MSG: std_msgs/Header", "builtin_interfaces/Time stamp", "string frame_id"),
        *(LINE, "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec"),
    ]
)


def write_bag(
    path: Path, states: str = "/arm/joint_states", commands: str = "/arm/commands", names=JOINTS, numbers: str = "",
    packing: str = "ZSTD", checksums: bool = True, lacks: dict[str, int] | None = None,
) -> Path:  # fmt: skip
    """A bag of two topics of JointState, and one of plain numbers where its name is given.

    Of the second joint the fields that are named in ``lacks`` are NaN in that row and all after it.
    """
    writer_of = pytest.importorskip("mcap_ros2.writer", reason="the extra ros is not installed")
    how = pytest.importorskip("mcap.writer").CompressionType[packing]
    with open(path, "wb") as file, writer_of.Writer(file, compression=how, enable_crcs=checksums) as writer:
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", DEFINITION)
        head = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
        for row, (time, target, angle) in enumerate(zip(TIME, TARGET, ANGLE, strict=True)):
            order = {"name": names[::-1], "position": target[::-1].tolist(), "velocity": [], "effort": []}
            writer.write_message(commands, schema, {"header": head} | order, log_time=int(1e9 * time) + 1)
            measured = {"name": JOINTS, "position": angle.tolist(), "velocity": (2 * angle).tolist(), "effort": []}
            for name, first in (lacks or {}).items():
                measured[name] = [0.0, np.nan if row >= first else 0.0]
            writer.write_message(states, schema, {"header": head} | measured, log_time=int(1e9 * time) + 2)
        if numbers:
            plain = writer.register_msgdef("std_msgs/msg/Float64MultiArray", "float64[] data")
            writer.write_message(numbers, plain, {"data": [0.5]}, log_time=0)
    return path


def test_states_with_the_command_in_force(tmp_path: Path):
    log = read_log(write_bag(tmp_path / "a.mcap"))
    assert log.joint_names == JOINTS[::-1] and log.joint_torque is None and log.joint_vel is not None
    np.testing.assert_allclose(log.time, TIME, atol=2e-9)
    np.testing.assert_array_equal(log.joint_pos, ANGLE[:, ::-1])
    np.testing.assert_array_equal(log.joint_vel, 2 * ANGLE[:, ::-1])
    np.testing.assert_array_equal(log.position_target, TARGET[:, ::-1])


def test_a_velocity_or_an_effort_that_a_joint_never_says_is_absent(tmp_path: Path):
    """As the broadcaster of ros2_control writes it, where a joint lacks the interface."""
    log = read_log(write_bag(tmp_path / "a.mcap", lacks={"velocity": 0, "effort": 0}))
    assert log.joint_vel is None and log.joint_torque is None
    np.testing.assert_array_equal(log.joint_pos, ANGLE[:, ::-1])


@pytest.mark.parametrize("lacks", [{"velocity": 5}, {"effort": 5}, {"position": 0}])
def test_what_a_joint_says_in_some_rows_only_is_refused(tmp_path: Path, lacks: dict[str, int]):
    with pytest.raises(LogError, match=rf"row {min(lacks.values())}, joint_\w+/lift is nan"):
        read_log(write_bag(tmp_path / "a.mcap", lacks=lacks))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"states": "/arm/states"}, r"topics of sensor_msgs/msg/JointState are /arm/commands, /arm/states"),
        ({"commands": "/b/joint_states"}, "topics of"),
        (
            {"states": "/arm/states", "numbers": "/cmd"},
            r"/arm/states; others: /cmd \(std_msgs/msg/Float64MultiArray\) -> .* or read its topics with columns",
        ),
        ({"names": ("pan", "tail")}, "the command has a joint 'tail'"),
        ({"names": ("pan", "pan")}, "is of the joints"),
    ],
)
def test_other_topics_are_refused_with_their_names(tmp_path: Path, changes: dict[str, object], said: str):
    with pytest.raises(LogError, match=said):
        read_log(write_bag(tmp_path / "a.mcap", **changes))  # pyright: ignore[reportArgumentType]


def write_folder(folder: Path, *names: str) -> Path:
    """As `ros2 bag record` leaves it."""
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    for name in names:
        write_bag(folder / name)
    return folder


def test_the_folder_of_a_bag_is_its_one_file(tmp_path: Path):
    (tmp_path / "run").mkdir()
    folder = write_folder(tmp_path / "run", "run_0.mcap")
    np.testing.assert_array_equal(read_log(folder).joint_pos, read_log(folder / "run_0.mcap").joint_pos)
    assert list(read_log_folder(folder, None).logs) == ["run"]
    write_bag(folder / "run_1.mcap")
    with pytest.raises(LogError, match=r"a folder, and no log by itself -> give its files: .*\.mcap"):
        read_log(folder)
    assert list(read_log_folder(folder, None).logs) == ["run_0", "run_1"], "a bag in two files"


def test_a_bag_in_another_storage_is_told_to_be_converted(tmp_path: Path):
    folder = write_folder(tmp_path)
    (folder / "run_0.db3").write_bytes(b"SQLite format 3")
    with pytest.raises(LogError, match=r"not stored as MCAP: run_0\.db3 -> .*ros2 bag convert"):
        read_log(folder)


def test_a_bag_without_joint_states_says_what_it_has(tmp_path: Path):
    writer_of = pytest.importorskip("mcap_ros2.writer", reason="the extra ros is not installed")
    with open(tmp_path / "a.mcap", "wb") as file, writer_of.Writer(file) as writer:
        plain = writer.register_msgdef("std_msgs/msg/Float64MultiArray", "float64[] data")
        writer.write_message("/cmd", plain, {"data": [0.5]}, log_time=0)
    with pytest.raises(LogError, match=r"no topic of .*; others: /cmd \(std_msgs/msg/Float64MultiArray\)"):
        read_log(tmp_path / "a.mcap")


@given(share=st.floats(0.0, 1.0, exclude_max=True), byte=st.none() | st.integers(0, 255))
@settings(max_examples=50, deadline=None)
def test_a_damaged_bag_is_refused_or_read_as_it_was(
    tmp_path_factory: pytest.TempPathFactory, share: float, byte: int | None
):
    """Chunks and summary have checksums, and nothing else is read."""
    path = write_bag(tmp_path_factory.mktemp("bag") / "a.mcap")
    whole, is_cut = read_log(path), damage(path, share, byte)
    try:
        assert log_digest(read_log(path)) == log_digest(whole) and not is_cut
    except LogError as error:
        assert "a.mcap" in str(error) and len(str(error)) < 1000


def test_every_byte_of_a_bag_may_be_another_one(tmp_path: Path):
    path = write_bag(tmp_path / "a.mcap")
    data, whole, refused = path.read_bytes(), log_digest(read_log(path)), 0
    for place in range(0, len(data), 7):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x40]) + data[place + 1 :])
        try:
            assert log_digest(read_log(path)) == whole, place
        except LogError:
            refused += 1
    assert refused > len(data) // 14, "only what nobody reads, such as the index of messages, may be damaged"


@pytest.mark.parametrize("packing", ["NONE", "LZ4", "ZSTD"])
def test_a_chunk_of_another_checksum_is_refused(tmp_path: Path, packing: str):
    """Unpacked, such a byte is an angle."""
    path = write_bag(tmp_path / "a.mcap", packing=packing)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"a\.mcap: (a chunk is damaged: its checksum|cannot be read)"):
        read_log(path)


def test_a_bag_without_checksums_is_read(tmp_path: Path):
    path = write_bag(tmp_path / "a.mcap", checksums=False)
    np.testing.assert_array_equal(read_log(path).joint_pos, ANGLE[:, ::-1])


@pytest.mark.parametrize("left", [40, 2000, -8, -1])
def test_a_bag_whose_recorder_died_is_told_to_be_recovered(tmp_path: Path, left: int):
    path = write_bag(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(
        LogError, match=r"a\.mcap: the bag is not finished: its recorder was not closed.*`mcap recover`"
    ):
        read_log(path)


def test_a_bag_without_a_summary_is_told_to_be_recovered(tmp_path: Path):
    path = write_bag(tmp_path / "a.mcap")
    data = bytearray(path.read_bytes())
    data[-8 - 20 : -8] = bytes(20)  # of the footer: where the summary begins, where its offsets do, its checksum
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"a\.mcap: the bag has no summary: .*`mcap recover`"):
        read_log(path)


def test_what_is_no_bag_says_so(tmp_path: Path):
    pytest.importorskip("mcap.reader", reason="the extra ros is not installed")
    (tmp_path / "a.mcap").write_bytes(b"SQLite format 3")
    with pytest.raises(LogError, match=r"a\.mcap: not an MCAP file"):
        read_log(tmp_path / "a.mcap")


def test_without_the_extra_the_message_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "mcap.reader", None)
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(LogError, match=r"motorprior\[ros\]"):
        read_log(tmp_path / "a.mcap")


def write_packed(
    path: Path, packing: str, message: bytes, chunk_size: int = 1_000_000, count: int = 1, encoding: str = "cdr",
    checksums: bool = True,
) -> Path:  # fmt: skip
    """A bag of one topic whose messages are these bytes."""
    writer_of = pytest.importorskip("mcap.writer", reason="the extra ros is not installed")
    how = {"zstd": writer_of.CompressionType.ZSTD, "lz4": writer_of.CompressionType.LZ4}[packing]
    with open(path, "wb") as file:
        writer = writer_of.Writer(file, chunk_size=chunk_size, compression=how, enable_crcs=checksums)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", DEFINITION.encode())
        channel = writer.register_channel("/joint_states", encoding, schema)
        for time in range(count):
            writer.add_message(channel, log_time=time, data=message, publish_time=time)
        writer.finish()
    return path


def test_an_encoding_that_is_not_ros_2_s_is_named(tmp_path: Path):
    path = write_packed(tmp_path / "a.mcap", "zstd", b"{}", encoding="json")
    with pytest.raises(LogError, match=r"a\.mcap: messages of /joint_states are encoded as 'json' -> .*cdr"):
        read_log(path)


@pytest.mark.parametrize("packing", ["zstd", "lz4"])
def test_a_chunk_that_unpacks_to_too_much_is_refused_before_it_does(tmp_path: Path, packing: str):
    path = write_packed(tmp_path / "a.mcap", packing, bytes(70_000_000))
    assert path.stat().st_size < 1_000_000
    with pytest.raises(LogError, match=r"a\.mcap: a chunk of 7\d{7} bytes, more than 64000000"):
        read_log(path)


def test_many_chunks_that_unpack_to_too_much_together_are_refused(tmp_path: Path):
    path = write_packed(tmp_path / "a.mcap", "zstd", bytes(5_000_000), count=25)
    assert path.stat().st_size < 400_000
    with pytest.raises(LogError, match="it unpacks to more than 100000000 bytes"):
        read_log(path)


@pytest.mark.parametrize("packing", ["zstd", "lz4"])
@pytest.mark.parametrize("said", [1000, 30_000_000])
def test_a_chunk_that_does_not_unpack_to_what_it_says_is_refused(packing: str, said: int):
    records = pytest.importorskip("mcap.records", reason="the extra ros is not installed")
    module = {"zstd": "zstandard", "lz4": "lz4.frame"}[packing]
    packed = pytest.importorskip(module, reason="the extra ros is not installed").compress(bytes(20_000_000))
    chunk = records.Chunk(
        compression=packing, data=packed, message_start_time=0, message_end_time=0, uncompressed_crc=0,
        uncompressed_size=said,
    )  # fmt: skip
    with pytest.raises(LogError, match=f"says that it unpacks to {said} bytes, and does not"):
        unpacked(chunk, Path("a.mcap"))
    whole = unpacked(replace(chunk, uncompressed_size=20_000_000), Path("a.mcap"))
    assert whole.data == bytes(20_000_000) and whole.compression == ""


def test_chunks_in_one_another_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One chunk named a thousand times would be a thousand times the data."""
    summaries = pytest.importorskip("mcap.reader", reason="the extra ros is not installed")
    path, read = write_bag(tmp_path / "a.mcap"), summaries.SeekingReader.get_summary

    def doubled(self: object) -> object:
        summary = read(self)
        summary.chunk_indexes += summary.chunk_indexes
        return summary

    monkeypatch.setattr(summaries.SeekingReader, "get_summary", doubled)
    with pytest.raises(LogError, match="lie in one another"):
        read_log(path)


def test_a_bag_whose_summary_names_no_chunks_is_read_from_its_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    summaries = pytest.importorskip("mcap.reader", reason="the extra ros is not installed")
    path, read = write_bag(tmp_path / "a.mcap"), summaries.SeekingReader.get_summary
    indexed = read_log(path)

    def without(self: object) -> object:
        summary = read(self)
        summary.chunk_indexes.clear()
        return summary

    monkeypatch.setattr(summaries.SeekingReader, "get_summary", without)
    np.testing.assert_array_equal(read_log(path).joint_pos, indexed.joint_pos)


def test_a_chunk_where_the_summary_should_be_is_refused(tmp_path: Path):
    """The library would unpack it, without a bound."""
    pytest.importorskip("mcap.reader", reason="the extra ros is not installed")
    path = write_packed(tmp_path / "a.mcap", "zstd", bytes(5_000_000), checksums=False)
    data = bytearray(path.read_bytes())
    footer = len(data) - 8 - 29  # magic, and the record: kind, length, where the summary begins, two more numbers
    assert data[footer] == 2
    data[footer + 9 : footer + 17] = data.index(b"\x06", 8).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(LogError, match="its summary holds a chunk of messages"):
        read_log(path)
