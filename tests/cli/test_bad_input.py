"""Whatever is wrong, one line says what, where and what to do; exit code 2; nothing half-written stays."""

import gzip
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from motorprior.actuator.motor_prior import SCHEMA_VERSION, MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bench.fleet import fleet_path
from motorprior.cli import main as command
from motorprior.cli.speed import Speed
from motorprior.identification.presets import identification_preset
from motorprior.pipeline.bench import Bench, run_bench

Command = Callable[..., Any]
Edit = Callable[[Path], object]


def in_a_process(*args: object, first: str = "") -> subprocess.CompletedProcess[str]:
    """The real thing, after the statement ``first``."""
    code = f"{first}\nfrom motorprior.cli.main import main\nmain()"
    words = [sys.executable, "-c", code, *map(str, args)]
    return subprocess.run(words, capture_output=True, text=True, check=False)


# Numbers and names on the command line.


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("bench --motors 0", ("--motors 0", "from 1 to 4096")),
        ("bench --motors -3", ("--motors -3",)),
        ("bench --steps 1", ("--steps 1", "from 2 to 1000000")),
        ("bench --seed -1", ("--seed -1", "from 0 to 2147483647")),
        ("bench --seed 99999999999999999999", ("--seed", "to 2147483647")),
        ("bench --preset unknown", ("'unknown'", "rollout", "paper")),
        ("bench --fleet unknown", ("'unknown'", "pupper_v2", "mixed")),
        ("bench --fleet nowhere.toml", ("nowhere.toml", ".toml file")),
        ("identify {bench} --steps 0", ("--steps 0",)),
        ("identify {bench} --seed -1", ("--seed -1",)),
        ("identify {bench} --preset unknown", ("'unknown'", "rollout", "one_network")),
        ("validate {prior} --seed -1", ("--seed -1",)),
        ("validate", ("no prior", "identify")),
        ("validate {prior} {prior}", ("two priors", "rollout")),
        ("replay {logs} --prior {prior} --draws 0", ("--draws 0",)),
        ("replay {logs} --prior {prior} --seed -1", ("--seed -1",)),
        ("replay {logs} --prior {prior} --fleet unknown", ("'unknown'", "pupper_v2")),
        ("walk --actuator pd --iterations 0", ("--iterations 0",)),
        ("walk --actuator pd --iterations -1", ("--iterations -1",)),
        ("walk --actuator pd --episode-steps 0", ("--episode-steps 0",)),
        ("walk --actuator pd --workers 0", ("--workers 0",)),
        ("walk --actuator pd --kp -1", ("--kp -1",)),
        ("walk --actuator pd --kd nan", ("--kd nan", "finite number")),
        ("walk --actuator pd --torque-limit inf", ("--torque-limit inf", "finite number")),
        ("walk --actuator pd --delay 1e9", ("--delay 1000000000", "to 1")),
        ("walk --actuator pd --kp 1e300", ("--kp 1e+300", "to 1e+09")),
        ("walk --actuator pd --kd 1e300", ("--kd 1e+300", "to 1e+09")),
        ("walk --actuator pd --torque-limit 1e300", ("--torque-limit 1e+300", "to 1e+09")),
        ("walk --actuator pd --armature 1e300", ("--armature 1e+300", "to 1000")),
        ("walk --actuator pd --episode-steps 1000000000", ("--episode-steps 1000000000", "to 100000")),
        ("walk --actuator pd --task.alive nan", ("--task.alive nan",)),
        ("walk --actuator pd --fleet unknown", ("'unknown'", "pupper_v2")),
        ("walk --actuator pd --prior {prior}", ("--actuator pd", "prior.safetensors")),
        ("walk", ("--actuator prior", "file of a prior")),
        ("transfer", ("no policy", "walk")),
        ("transfer {walk} --fleet unknown", ("'unknown'", "pupper_v2")),
        ("demo --motors 5", ("--motors 5", "at least 12")),
        ("demo --bench-steps 0", ("--bench-steps 0",)),
        ("demo --adam-steps 0", ("--adam-steps 0",)),
        ("demo --iterations 0", ("--iterations 0",)),
        ("demo --seeds 0", ("--seeds 0",)),
        ("demo --seed -1", ("--seed -1",)),
        ("demo --workers 0", ("--workers 0",)),
        ("demo --fleet unknown", ("'unknown'", "pupper_v2")),
        ("demo --logs nowhere", ("nowhere", "jietan/puppersim")),
    ],
)
def test_a_setting_out_of_range_is_named_with_its_bound(
    refused: Command, tmp_path: Path, bench: Path, prior: Path, walk: Path, pupper_logs: Path, line: str, words: tuple
):
    paths = {"bench": bench, "prior": prior, "walk": walk, "logs": pupper_logs}
    refused(*line.format(**paths).split(), "--out", tmp_path / "out", words=words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "line",
    [
        "walk --search.num-directions 0", "walk --search.num-directions 1000000000", "walk --search.seed -1",
        "walk --search.seed 10000000000000000", "walk --search.delta-std 0", "walk --search.delta-std 1e300",
        "walk --search.step-size 1e300",
    ],
)  # fmt: skip
def test_settings_of_the_search_that_do_not_fit_are_refused(motorprior: Command, tmp_path: Path, line: str):
    outcome = motorprior(*line.split(), "--actuator", "pd", "--out", tmp_path / "out")
    assert outcome.code == 2 and outcome.err.startswith("error:") and line.split()[1] in outcome.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("line", ["", "fly", "bench", "bench --out x --motors many", "walk --out x --actuator servo"])
def test_a_command_line_that_says_nothing_exits_with_2(motorprior: Command, line: str):
    outcome = motorprior(*line.split())
    assert outcome.code == 2 and "Traceback" not in outcome.err


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("center = ", "center = -", ("not a finite number", "above 0")),
        ("center = ", "center = nan # ", ("not a finite number",)),
        ('unit = "', 'unit = "k', ("unit",)),
        ("[kp]", "[kp_of_another]", ("kp_of_another", "missing keys ['kp']")),
        ('robot = "', "robot = ", ("not valid TOML",)),
    ],
)
def test_a_fleet_with_a_bad_value_is_refused(refused: Command, tmp_path: Path, old: str, new: str, words: tuple):
    fleet = tmp_path / "mine.toml"
    text = fleet_path("pupper_v2").read_text("utf-8")
    assert old in text
    fleet.write_text(text.replace(old, new, 1), "utf-8")
    for line in ("bench", "walk --actuator fleet", "demo"):
        refused(*line.split(), "--fleet", fleet, "--out", tmp_path / "out", words=("mine.toml", *words))


# Motor logs.


def edit_column(name: str, change: Callable[[np.ndarray], object]) -> Edit:
    """Change one column of a Parquet file and keep its header."""

    def edit(path: Path) -> None:
        table = pq.read_table(path)
        column = table.column(name).to_numpy().copy()
        change(column)
        pq.write_table(table.set_column(table.column_names.index(name), name, pa.array(column)), path)

    return edit


def put(row: int, value: float) -> Callable[[np.ndarray], object]:
    return lambda column: column.__setitem__(row, value)


def drop_column(name: str) -> Edit:
    return lambda path: pq.write_table(pq.read_table(path).drop_columns([name]), path)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def edit_header(key: str, value: object) -> Edit:
    def edit(path: Path) -> None:
        table = pq.read_table(path)
        header = json.loads(table.schema.metadata[b"motorprior"]) | {key: value}
        pq.write_table(table.replace_schema_metadata({b"motorprior": json.dumps(header).encode()}), path)

    return edit


BROKEN_LOGS = {
    "missing": (Path.unlink, ("no such file",)),
    "empty": (lambda path: path.write_bytes(b""), ("not a complete Parquet file",)),
    "truncated": (truncate, ("not a complete Parquet file",)),
    "NaN": (edit_column("joint_pos_rad/motor_001", put(7, np.nan)), ("row 7", "joint_pos/motor_001", "nan")),
    "infinite": (edit_column("joint_torque_N_m/motor_000", put(3, np.inf)), ("row 3", "joint_torque/motor_000")),
    "repeated time": (edit_column("time_s", lambda time: put(10, time[9])(time)), ("row 10", "time repeats")),
    "unsorted time": (edit_column("time_s", lambda time: put(10, time[5])(time)), ("row 10", "runs backwards")),
    "no inertia": (edit_column("load_inertia_kg_m2/motor_000", put(0, 0.0)), ("row 0", "load_inertia", "0.0")),
    "joint count": (drop_column("joint_pos_rad/motor_002"), ("missing columns", "joint_pos_rad/motor_002")),
    "degrees": (edit_header("units", {"time": "s", "joint_pos": "deg"}), ("units", "deg", "rad")),
    "newer schema": (edit_header("schema_version", 4), ("schema version 4", "reads 3")),
}


@pytest.mark.parametrize(("edit", "words"), BROKEN_LOGS.values(), ids=list(BROKEN_LOGS))
def test_a_broken_log_is_refused_by_whoever_reads_it(
    refused: Command, tmp_path: Path, bench: Path, edit: Edit, words: tuple[str, ...]
):
    copy = shutil.copytree(bench, tmp_path / "bench")
    log = copy / "log.parquet"
    edit(log)
    refused("identify", copy, "--out", tmp_path / "out", words=(str(log), *words))
    refused("logs", "check", log, words=(str(log), *words))
    refused("logs", "import", log, "--out", tmp_path / "out", words=(str(log), *words))


def test_a_log_that_was_never_a_motor_log_is_refused(refused: Command, tmp_path: Path):
    pq.write_table(pa.table({"time": [0.0, 1.0]}), tmp_path / "foreign.parquet")
    refused("logs", "check", tmp_path / "foreign.parquet", words=("foreign.parquet", "logs import"))


def test_a_log_of_the_other_bench_is_refused(refused: Command, tmp_path: Path):
    run_bench(Bench(tmp_path / "bench", preset="paper", motors=2, steps=200))
    words = ("log.parquet", "0.01 s", "0.002 s", "period 0.002")
    refused("identify", tmp_path / "bench", "--out", tmp_path / "out", words=words)


def test_a_log_shorter_than_a_window_is_refused(refused: Command, tmp_path: Path):
    run_bench(Bench(tmp_path / "bench", motors=2, steps=50))
    recipe = identification_preset("rollout")
    rows = recipe.history + recipe.window + 1  # and the row that its last step leads to
    words = ("log.parquet", "has 50 rows", f"a window {rows}", "record longer")
    refused("identify", tmp_path / "bench", "--out", tmp_path / "out", words=words)


def test_no_logs_at_all_are_refused(refused: Command, tmp_path: Path):
    refused("logs", "check", words=("no log given", "give at least one"))
    refused("logs", "import", "--out", tmp_path / "out", words=("no log given", "give at least one"))


# The facts beside a log.


def edit_json(**changes: object) -> Edit:
    return lambda path: path.write_text(json.dumps(json.loads(path.read_text()) | changes))


BROKEN_FACTS = {
    "missing": (Path.unlink, ("no such file", "check the path")),
    "garbled": (lambda path: path.write_text('{"fleet": '), ("not valid JSON",)),
    "not a table": (lambda path: path.write_text("[1, 2]"), ("are missing",)),
    "another key": (edit_json(colour="red"), ("unknown keys ['colour']",)),
    "a missing key": (lambda path: path.write_text('{"fleet": "x"}'), ("missing keys",)),
    "no parameters": (edit_json(parameters=3), ("cannot be drawn again",)),
    "half a parameter": (edit_json(parameters={"kp": {"kind": "normal"}}), ("cannot be drawn again",)),
    "a negative seed": (edit_json(seed=-1), ("cannot be drawn again",)),
    "other motors": (edit_json(motors=5), ("12 motors", "says 5")),
}


@pytest.mark.parametrize(("edit", "words"), BROKEN_FACTS.values(), ids=list(BROKEN_FACTS))
def test_a_broken_bench_folder_is_refused(
    refused: Command, tmp_path: Path, bench: Path, edit: Edit, words: tuple[str, ...]
):
    copy = shutil.copytree(bench, tmp_path / "bench")
    edit(copy / "bench.json")
    refused("identify", copy, "--out", tmp_path / "out", words=("bench.json", *words))


# Priors.


def resave(**changes: object) -> Edit:
    """The same prior with other header entries."""

    def edit(path: Path) -> None:
        tensors, header = read_tensors(path)
        write_tensors(path, tensors, header | changes)

    return edit


def put_nan(path: Path) -> None:
    tensors, header = read_tensors(path)
    tensors["w1"][1, 2] = np.nan
    write_tensors(path, tensors, header)


def drop_weights(path: Path) -> None:
    tensors, header = read_tensors(path)
    del tensors["w2"]
    write_tensors(path, tensors, header)


BROKEN_PRIORS = {
    "missing": (Path.unlink, ("check the path",)),
    "truncated": (truncate, ("not a complete safetensors file",)),
    "text": (lambda path: path.write_text("prior"), ("not a complete safetensors file",)),
    "NaN": (put_nan, ("w1[1, 2] is not finite",)),
    "unknown key": (resave(colour="red"), ("unknown keys ['colour']",)),
    "weights left out": (drop_weights, ("missing keys ['w2']",)),
    "other robot": (resave(robot="go1"), ("'go1'", "pupper_v2")),
    "newer schema": (
        resave(schema_version=SCHEMA_VERSION + 1),
        (f"schema_version {SCHEMA_VERSION + 1}, this one reads {SCHEMA_VERSION} -> update motorprior",),
    ),
    "a policy": (resave(kind="policy"), ("a policy, not a motor prior", "identify")),
    "other units": (resave(units={"position": "deg"}), ("deg", "rad")),
    "other period": (resave(period=0.003), ("0.003",)),
}


@pytest.mark.parametrize(("edit", "words"), BROKEN_PRIORS.values(), ids=list(BROKEN_PRIORS))
def test_a_broken_prior_is_refused_by_whoever_reads_it(
    refused: Command, tmp_path: Path, prior: Path, pupper_logs: Path, edit: Edit, words: tuple[str, ...]
):
    copy = Path(shutil.copy(prior, tmp_path / "mine.safetensors"))
    edit(copy)
    out = ("--out", tmp_path / "out")
    refused("validate", copy, *out, words=(str(copy), *words))
    refused("replay", pupper_logs, "--prior", copy, *out, words=(str(copy), *words))
    refused("walk", "--prior", copy, *out, words=(str(copy), *words))
    refused("speed", "--prior", copy, "--json", tmp_path / "out", words=(str(copy), *words))


def test_a_prior_that_forgot_its_bench_cannot_be_validated(refused: Command, tmp_path: Path, prior: Path):
    copy = Path(shutil.copy(prior, tmp_path / "mine.safetensors"))
    resave(provenance={})(copy)
    refused("validate", copy, "--out", tmp_path / "out", words=("mine.safetensors", "bench"))


def test_a_bench_of_fewer_motors_than_a_robot_cannot_be_validated(
    refused: Command, tmp_path: Path, prior_of_bench: MotorPrior
):
    facts = prior_of_bench.provenance["bench"] | {"motors": 5}
    latents = prior_of_bench.mean[:5]
    few = replace(prior_of_bench, mean=latents, log_var=latents, provenance={"bench": facts})
    few.save(tmp_path / "few.safetensors")
    words = ("few.safetensors", "5 motors", "12 motors or more")
    refused("validate", tmp_path / "few.safetensors", "--out", tmp_path / "out", words=words)


def test_priors_of_different_motors_are_not_compared(
    refused: Command, tmp_path: Path, prior: Path, prior_of_bench: MotorPrior
):
    facts = prior_of_bench.provenance["bench"] | {"seed": 1}
    replace(prior_of_bench, preset="paper", provenance={"bench": facts}).save(tmp_path / "other.safetensors")
    paths = (prior, tmp_path / "other.safetensors")
    refused("validate", *paths, "--out", tmp_path / "out", words=("other.safetensors", "same motors"))


# Logs of the real robot.


def edit_cell(row: int, column: int, value: str) -> Edit:
    def edit(path: Path) -> None:
        lines = path.read_text().splitlines()
        cells = lines[row + 1].split(",")
        cells[column] = value
        lines[row + 1] = ",".join(cells)
        path.write_text("\n".join(lines) + "\n")

    return edit


def drop_last_joint(path: Path) -> None:
    path.write_text("".join(line.rsplit(",", 1)[0] + "\n" for line in path.read_text().splitlines()))


def stand_still(path: Path) -> None:
    header, first, *_ = path.read_text().splitlines()
    rest = first.split(",", 1)[1]
    path.write_text("\n".join([header, *(f"{0.01 * row},{rest}" for row in range(20))]) + "\n")


BROKEN_PUPPER_LOGS = {
    "NaN": (edit_cell(4, 14, "nan"), ("row 4", "joint_pos/FR_hip", "nan")),
    "a word": (edit_cell(4, 14, "fast"), ("row 4", "q_1", "'fast'")),
    "repeated time": (edit_cell(5, 0, "0.04"), ("row 5", "0.04", "repeats")),
    "joint count": (drop_last_joint, ("28 columns, expected 29",)),
    "header only": (lambda path: path.write_text(path.read_text().splitlines()[0] + "\n"), ("no rows",)),
    "no log": (Path.unlink, ("no log of a real robot", "jietan/puppersim")),
}


@pytest.mark.parametrize(("edit", "words"), BROKEN_PUPPER_LOGS.values(), ids=list(BROKEN_PUPPER_LOGS))
def test_a_broken_pupper_log_is_refused(
    refused: Command, tmp_path: Path, prior: Path, pupper_logs: Path, edit: Edit, words: tuple[str, ...]
):
    log = pupper_logs / "env_real_tiny_log.csv"
    edit(log)
    out = ("--out", tmp_path / "out")
    name = str(log) if log.exists() else str(pupper_logs)
    refused("replay", pupper_logs, "--prior", prior, *out, words=(name, *words))
    refused("demo", "--logs", pupper_logs, *out, words=(name, *words))
    if log.exists():
        refused("logs", "import", log, *out, words=(name, *words))
        refused("logs", "check", log, words=(name, *words))


def test_a_pupper_log_in_which_nothing_moves_is_refused(
    refused: Command, motorprior: Command, tmp_path: Path, prior: Path, pupper_logs: Path
):
    log = pupper_logs / "env_real_tiny_log.csv"
    stand_still(log)
    words = (str(pupper_logs), "tiny", "no joint is excited")
    refused("replay", pupper_logs, "--prior", prior, "--out", tmp_path / "out", words=words)
    refused("demo", "--logs", pupper_logs, "--out", tmp_path / "out", words=words)
    outcome = motorprior("logs", "check", log)
    assert outcome.code == 2 and str(log) in outcome.err and "no joint is excited" in outcome.out


def test_a_truncated_real_log_is_refused(refused: Command, tmp_path: Path, prior: Path, shared_data: Path):
    copy = tmp_path / "logs" / "env_real_lr_log.csv.gz"
    copy.parent.mkdir()
    copy.write_bytes((shared_data / "pupper_v2" / copy.name).read_bytes()[:5000])
    words = (str(copy), "truncated", "copy the file again")
    refused("replay", copy.parent, "--prior", prior, "--out", tmp_path / "out", words=words)
    refused("logs", "check", copy, words=words)


def test_a_truncated_gzip_is_refused(refused: Command, tmp_path: Path, pupper_logs: Path):
    log = pupper_logs / "env_real_tiny_log.csv"
    packed = tmp_path / "env_real_tiny_log.csv.gz"
    packed.write_bytes(gzip.compress(log.read_bytes())[:-50])
    refused("logs", "check", packed, words=(str(packed), "truncated", "copy the file again"))


def test_two_logs_of_one_name_are_not_written_over_each_other(refused: Command, tmp_path: Path, pupper_logs: Path):
    log = pupper_logs / "env_real_tiny_log.csv"
    twin = Path(shutil.copy(log, tmp_path / log.name))
    refused("logs", "import", log, twin, "--out", tmp_path / "out", words=(str(twin), str(log), "rename"))


# A file in another one's place.


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("identify {table}", ("{table}: ", "not a motor log (.parquet)", "`motorprior logs import`")),
        ("identify {prior}", ("{prior}: ", "not a motor log (.parquet)")),
        ("identify {bench}/nowhere", ("{bench}/nowhere: no such file",)),
        ("adapt {prior} {table}", ("{table}: ", "not a motor log (.parquet)", "`motorprior logs import`")),
        ("validate {table}", ("{table}: not a complete safetensors file, but a text, such as a table", "`identify`")),
        ("validate {bench}", ("{bench}: a folder, not a file -> give the prior.safetensors that `identify` wrote",)),
        ("validate {short}", ("{short}: not a complete safetensors file, but a text",)),
        ("identify {walk}", ("{walk}: a folder without log.parquet", "`motorprior bench`")),
        ("identify {prior}", ("this is what was made of logs: give the logs themselves",)),
        ("transfer {table}", ("{table}: not a complete safetensors file, but a text", "`walk`")),
        (
            "validate {walk}/policy.safetensors",
            ("policy.safetensors: a policy, not a motor prior -> give the prior.safetensors that `identify` wrote",),
        ),
        ("validate {folder}", ("{folder}: a folder, not a file -> give {prior}",)),
        ("walk --prior {folder}", ("{folder}: a folder, not a file -> give {prior}",)),
        (
            "transfer {prior}",
            ("{prior}: a motor prior, not a policy -> give the policy.safetensors that `walk` wrote",),
        ),
        ("identify {copy}", ("{copy}: the log of a bench without its bench.json", "`motorprior identify FOLDER`")),
    ],
)
def test_a_file_of_another_kind_is_named_with_what_would_work(
    refused: Command, tmp_path: Path, bench: Path, prior: Path, walk: Path, pupper_logs: Path, line: str,
    words: tuple[str, ...],
):  # fmt: skip
    copy = Path(shutil.copy(bench / "log.parquet", tmp_path / "copy.parquet"))
    paths = {"table": pupper_logs / "env_real_tiny_log.csv", "bench": bench, "prior": prior, "copy": copy}
    paths |= {"walk": walk, "folder": prior.parent, "short": tmp_path / "short.csv"}
    paths["short"].write_text("a,b")
    said = tuple(word.format(**paths) for word in words)
    refused(*line.format(**paths).split(), "--out", tmp_path / "out", words=said)


def test_the_log_of_a_bench_is_its_folder(motorprior: Command, tmp_path: Path, bench: Path):
    for given, out in ((bench, "folder"), (bench / "log.parquet", "log")):
        assert motorprior("identify", given, "--preset", "paper_wide", "--steps", 1, "--out", tmp_path / out).code == 0
    priors = [MotorPrior.load(tmp_path / out / "prior.safetensors") for out in ("folder", "log")]
    assert priors[0].sha256() == priors[1].sha256() and priors[1].robot != "bench"


# Policies.


def write_nan_policy(path: Path) -> None:
    tensors, header = read_tensors(path)
    tensors["weights"][3, 4] = np.nan
    write_tensors(path, tensors, header)


BROKEN_POLICIES = {
    "missing": (Path.unlink, ("no such file", "check the path")),
    "truncated": (truncate, ("not a complete safetensors file",)),
    "NaN": (write_nan_policy, ("weights[3, 4] is not finite",)),
    "other robot": (resave(robot="go1"), ("'go1'", "pupper_v2")),
    "newer schema": (resave(schema_version=4), ("schema_version 4, this one reads 3 -> update motorprior",)),
    "of nobody": (resave(provenance={}), ("motors",)),
}


@pytest.mark.parametrize(("edit", "words"), BROKEN_POLICIES.values(), ids=list(BROKEN_POLICIES))
def test_a_broken_policy_is_refused(refused: Command, tmp_path: Path, walk: Path, edit: Edit, words: tuple[str, ...]):
    copy = shutil.copytree(walk, tmp_path / "walk")
    edit(copy / "policy.safetensors")
    words = (str(copy / "policy.safetensors"), *words)
    refused("transfer", copy, "--out", tmp_path / "out", words=words)


def test_a_policy_whose_prior_is_gone_or_changed_is_refused(
    refused: Command, motorprior: Command, tmp_path: Path, prior: Path
):
    copy, walk = Path(shutil.copy(prior, tmp_path / "mine.safetensors")), tmp_path / "walk"
    line = ("walk", "--prior", copy, "--out", walk, "--iterations", 1, "--episode-steps", 5, "--workers", 1)
    assert motorprior(*line).code == 0
    for edit in (resave(metrics={"changed": 1.0}), Path.unlink):
        edit(copy)
        words = ("policy.safetensors", "mine.safetensors", "put it back")
        refused("transfer", walk, "--out", tmp_path / "out", words=words)


# Folders.


@pytest.mark.parametrize(
    "line",
    [
        "bench --motors 1 --steps 2",
        "identify {bench} --steps 1",
        "validate {prior}",
        "replay {logs} --prior {prior}",
        "walk --actuator pd --iterations 1",
        "transfer {walk}",
        "logs import {logs}/env_real_tiny_log.csv",
        "demo",
    ],
)
@pytest.mark.parametrize("below", ["", "run"])
def test_a_folder_that_cannot_be_made_is_refused_before_the_work(
    refused: Command, tmp_path: Path, bench: Path, prior: Path, walk: Path, pupper_logs: Path, line: str, below: str
):
    (tmp_path / "file").write_text("in the way")
    paths = {"bench": bench, "prior": prior, "walk": walk, "logs": pupper_logs}
    out = tmp_path / "file" / below
    refused(*line.format(**paths).split(), "--out", out, words=(str(tmp_path / "file"), "another folder"))


def test_a_file_of_figures_that_cannot_be_written_is_refused_before_anything_is_timed(
    refused: Command, tmp_path: Path, prior: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("motorprior.pipeline.speed.measure", lambda *_, **__: pytest.fail("timed"))
    (tmp_path / "file").write_text("in the way")
    refused(
        "speed", "--prior", prior, "--json", tmp_path / "file" / "x.json", words=(str(tmp_path / "file"), "writable")
    )


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_read_only_folder_is_refused(refused: Command, tmp_path: Path):
    (tmp_path / "closed").mkdir(mode=0o500)
    words = (str(tmp_path / "closed"), "another folder")
    refused("bench", "--motors", 1, "--steps", 2, "--out", tmp_path / "closed", words=words)


def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, one_error: Command, pupper_logs: Path):
    log, out = pupper_logs / "env_real_tiny_log.csv", tmp_path / "out"
    no_room = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))"  # [bytes per file]
    result = in_a_process("logs", "import", log, "--out", out, first=no_room)
    assert result.returncode == 2
    one_error(result.stderr, (str(out / "env_real_tiny_log.parquet"), "free space"))
    assert not out.exists(), "not even an empty folder"


def test_a_report_needs_the_folder_of_a_demo(refused: Command, tmp_path: Path):
    refused("report", tmp_path, words=(str(tmp_path), "policy.safetensors", "motorprior demo"))
    for text in ("{", "[]", '{"settings": {"seed": 1}, "command": ""}'):
        (tmp_path / "demo.json").write_text(text)
        refused("report", tmp_path, words=(str(tmp_path / "demo.json"),))


def test_a_damaged_checkpoint_is_refused_with_a_way_out(refused: Command, tmp_path: Path, prior: Path):
    walk = tmp_path / "walk"
    walk.mkdir()
    shutil.copy(prior, walk / "search.safetensors")
    truncate(walk / "search.safetensors")
    line = ("walk", "--actuator", "pd", "--out", walk, "--iterations", 1)
    refused(*line, words=(str(walk / "search.safetensors"), "delete it"))


# The process itself.


def test_the_process_says_one_line_and_exits_with_2(tmp_path: Path, one_error: Command, bench: Path):
    copy = shutil.copytree(bench, tmp_path / "bench")
    BROKEN_LOGS["NaN"][0](copy / "log.parquet")
    result = in_a_process("identify", copy, "--out", tmp_path / "out")
    assert result.returncode == 2 and result.stdout == "" and result.stderr.count("\n") == 1
    one_error(result.stderr, ("log.parquet", "row 7", "joint_pos/motor_001", "nan"))
    assert not (tmp_path / "out").exists()


def test_a_bug_is_not_passed_off_as_bad_input(motorprior: Command, monkeypatch: pytest.MonkeyPatch, prior: Path):
    def bug(config: Speed) -> None:
        raise KeyError("a bug")

    monkeypatch.setitem(command.RUN, Speed, bug)
    with pytest.raises(KeyError, match="a bug"):
        motorprior("speed", "--prior", prior)
