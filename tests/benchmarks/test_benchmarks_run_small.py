"""Every benchmark runs as a user runs it, with settings that make it small."""

import json
import math
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


@dataclass(frozen=True)
class SmallRun:
    """A small run of a benchmark."""

    # {out}: run folder; {bench_prior}: a prior that was identified from a bench; {data}: folder of
    # real logs
    arguments: str
    files: tuple[str, ...] = ("figures.json",)  # files in the run folder; JSON holds figures
    package: str | None = None  # optional package that the benchmark needs


SMALL_RUNS = {
    "closing_the_loop": SmallRun(
        "--prior pupper_v2 --out {out} --robots 1 --seeds 1 --walks 1 --iterations 1 --further 1 "
        "--episode-steps 10 --directions 1 --walk-seconds 1 --record-seconds 5"
    ),
    "command_modes": SmallRun("--out {out} --mit 1 --torque 1 --seconds 4"),
    "demo_seeds": SmallRun(
        "--out {out} --seeds 0 1 '--options=--motors 12 --bench-steps 1500 --adam-steps 30 "
        "--iterations 1 --directions 2 --walks 2'",
        files=("figures.json", "table.md"),
    ),
    "encoder_place": SmallRun("--data {data} --out {out} --logs 8 --seconds 2"),
    "engines": SmallRun(
        "--prior pupper_v2 --figure {out}/engines.png --trots 1 --steps 20",
        files=("engines.png",),
        package="pybullet",
    ),
    "excitation": SmallRun(
        "--out {out} --runs 2 --held-out-runs 1 --run-seconds 5 --training-steps 2 --motors 12 "
        "--seconds 5 --seeds 1 --losses paper --kinds generated --adam-steps 2 "
        "--adapt-seconds 0 --budgets",
        files=("figures.json", "table.md", "report.html"),
    ),
    "exports": SmallRun("--out {out} --motors 2 --parity-motors 2 --parity-steps 20"),
    "fidelity": SmallRun(
        "--out {out} --motors 12 --steps 1000 --arms 1 --presets pace --no-position-only "
        "--adapt-seconds 1 --population 16",
        files=("figures.json", "tables.md"),
    ),
    "fleet_validation": SmallRun(
        "{bench_prior} --out {out} --adapt-seconds 1 --population 16",
    ),
    "go2_walking": SmallRun(
        "--data {data} --out {out} --logs 2 --seconds-of-log 6 --policies 2 --iterations 1 "
        "--episode-steps 10 --walks 2 --seconds 1 --workers 1",
        files=("figures.json", "table.md"),
        package="pybullet",
    ),
    "motor_cards": SmallRun(
        "--data {data} --out {out} --work {out}/work --cards xl330 --seconds 6",
        files=("xl330/prior.safetensors", "xl330/README.md"),
    ),
    "noise": SmallRun(
        "--json {out}/noise.json --hours 0.001 --armings 1 --shares 0.03 --processes 1",
        files=("noise.json",),
    ),
    "out_of_family": SmallRun(
        "--out {out} --motors 12 --steps 1000 --families foreign_direct --presets pace "
        "--population 16"
    ),
    "outlier_test": SmallRun(
        "{bench_prior} --motors 2 --seconds 2 --changes none 'kd / 4'", files=()
    ),
    "published_motors": SmallRun(
        "--data {data} --out {out} --logs 1", files=("figures.json", "published.png")
    ),
    "real_logs": SmallRun(
        "--data {data} --out {out} --robots xl330 --logs 8 --folds 1 --seconds 2 --no-baselines"
    ),
    "servo_loop": SmallRun(
        "--out {out} --benches xl330 --seconds 8 --json {out}/figures.json",
        package="rustypot",
    ),
    "simulated_arms": SmallRun("--out {out} --motors 1 --seconds 6"),
    "speed": SmallRun("--prior pupper_v2 --steps 5 --rounds 1", files=()),
    "spread_between_units": SmallRun(
        "--out {out} --spreads 0 4 --benches 1 --policies 1 --pd-range 0.1 "
        "--prior-share 0.5 --motors 12 --bench-steps 1500 --adam-steps 30 --iterations 1 "
        "--walks 2 --seconds 2.5",
        files=("figures.json", "table.md", "spread.png"),
    ),
    "unit_spread": SmallRun("go2", files=()),
    "walking": SmallRun(
        "--out {out} --motors 4 --bench-steps 1000 --preset pace --speeds 0.3 --seeds 1 "
        "--iterations 1 --episode-steps 20 --draws 1 --seconds 3 --workers 1"
    ),
    "why_oscillation": SmallRun(
        "--out {out} --motors 12 --steps 500 --adam-steps 2 --loads 2 "
        "--variants \"the paper's recipe\" 'closed loop + armature'",
        files=("why.json", "why.png", "table.md"),
    ),
}
# programs without a run in SMALL_RUNS, and the reason
LEFT_OUT = {
    "acceptance": "it runs other benchmarks; see test_acceptance_collects_and_compares_figures",
    "gpu_speed": "it needs a GPU",
}


def run_benchmark(name: str, arguments: list[str]) -> str:
    """Output of a benchmark, which must succeed."""
    command = [sys.executable, str(BENCHMARKS / f"{name}.py"), *arguments]
    environment = os.environ | ONE_THREAD
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def numbers_of(value: object) -> list[float]:
    """All numbers in nested dictionaries and lists."""
    if isinstance(value, dict):
        value = list(value.values())
    if not isinstance(value, list):
        return [float(value)] if isinstance(value, int | float) else []
    numbers = []
    for item in value:
        numbers += numbers_of(item)
    return numbers


def test_every_benchmark_has_a_small_run():
    programs = set()
    for path in BENCHMARKS.glob("*.py"):
        if '__name__ == "__main__"' in path.read_text("utf-8"):
            programs.add(path.stem)
    assert programs == SMALL_RUNS.keys() | LEFT_OUT.keys()


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL_RUNS)
def test_a_benchmark_runs_small(name: str, tmp_path: Path, request: pytest.FixtureRequest):
    small_run = SMALL_RUNS[name]
    if small_run.package is not None and find_spec(small_run.package) is None:
        pytest.skip(f"{small_run.package} is not installed")

    places = {"out": tmp_path}
    fixtures = {"{bench_prior}": "bench_prior", "{data}": "shared_data"}
    for place, fixture in fixtures.items():
        if place in small_run.arguments:
            places[place.strip("{}")] = request.getfixturevalue(fixture)
    arguments = shlex.split(small_run.arguments.format(**places))
    output = run_benchmark(name, arguments)

    # without a file of figures, the printed ones count
    assert re.search(r"\d", output)
    assert not re.search(r"\b(nan|inf)\b", output)
    for file in small_run.files:
        path = tmp_path / file
        assert path.stat().st_size > 0
        if path.suffix == ".json":
            numbers = numbers_of(json.loads(path.read_text("utf-8")))
            assert numbers
            assert all(math.isfinite(number) for number in numbers)


@pytest.mark.slow
def test_acceptance_collects_and_compares_figures(tmp_path: Path):
    (tmp_path / "fidelity").mkdir()
    figures = {"standing_rmse/rollout": 0.01, "identify_seconds/rollout": 3.0}
    (tmp_path / "fidelity" / "figures.json").write_text(json.dumps(figures), "utf-8")
    (tmp_path / "fidelity.done").touch()
    run_benchmark(
        "acceptance",
        ["run", "--data", str(tmp_path), "--out", str(tmp_path), "--experiments", "fidelity"],
    )

    collected = tmp_path / "acceptance.json"
    assert json.loads(collected.read_text("utf-8")) == {"fidelity/standing_rmse/rollout": 0.01}
    output = run_benchmark("acceptance", ["compare", str(collected), str(collected)])
    assert "1 figures, 0 changed or missing, 0 new" in output
