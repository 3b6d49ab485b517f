"""Which code a stage's results depend on: what its module imports, and nothing else."""

import gc
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import pytest

from motorprior.logs.formats.column_map import shipped_maps
from motorprior.pipeline import digests, module_imports
from motorprior.pipeline.module_imports import sources

SOURCE = Path(digests.__file__).parents[1]
STAGES = sorted(
    file.relative_to(SOURCE)
    for file in (SOURCE / "pipeline").rglob("*.py")
    if "= description(" in file.read_text("utf-8")
)
"""Modules that describe a stage."""
POLICIES = {"walk", "transfer", "robustness", "study_pds", "study_watch"}


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of ours."""
    copy = tmp_path_factory.mktemp("copy") / SOURCE.name
    return shutil.copytree(SOURCE, copy, ignore=shutil.ignore_patterns("__pycache__"))


@cache
def counted(stage: Path) -> set[str]:
    return {name.partition("/")[2] for name in sources(SOURCE / stage, SOURCE, digests._LEFT_OUT)}


@pytest.mark.parametrize(
    ("edited", "again"),
    [
        *((name, set()) for name in ("hardware/virtual/firmware.py", "cli/console.py", "report/plots_style.py")),
        *((f"transfer/study_{name}.py", set()) for name in ("summary", "verdicts", "claims", "results")),
        ("pipeline/stopwatch.py", set()),
        ("__init__.py", set()),
        ("actuator/physical.py", {stage.stem for stage in STAGES}),
        *(
            (f"logs/formats/{name}", {"real_motors", "replay", "calibrate"})
            for name in ("lerobot.py", "lerobot_robots.toml")
        ),
        *((f"logs/formats/maps/{name}.toml", {"real_motors", "replay", "calibrate"}) for name in shipped_maps()),
        ("robots/pupper_v2/fleets/mixed.toml", set()),
        ("pipeline/adapt.py", {"adapt", "real_motors", "validate", "validate_log"}),
        ("pipeline/validation/log_baselines.py", {"log_baselines", "real_motors", "validate_log"}),
        ("pipeline/walking/training.py", POLICIES),
        ("simulation/bullet_backend.py", POLICIES),
        ("search/executor_process.py", {"study_watch"}),
    ],
)
def test_an_edit_runs_those_stages_again_that_import_it(edited: str, again: set[str]):
    assert (SOURCE / edited).is_file()
    assert {stage.stem for stage in STAGES if edited in counted(stage)} == again


def test_the_digest_of_a_stage_is_of_what_it_imports_wherever_the_package_is(package: Path):
    bench, walk = Path("pipeline", "bench.py"), Path("pipeline", "walking", "walk.py")
    look = Path("pipeline", "first_look", "real_motors.py")
    before = {stage: digests.package_digest(SOURCE / stage, SOURCE) for stage in (bench, walk, look)}
    for edited, again in {
        "hardware/virtual/firmware.py": [], "logs/formats/lerobot.py": [look], "pipeline/walking/training.py": [walk],
        "actuator/physical.py": [bench, walk, look], "logs/formats/maps/so101_sage.toml": [look],
        "robots/pupper_v2/fleets/mixed.toml": [],
    }.items():  # fmt: skip
        text = (package / edited).read_bytes()
        (package / edited).write_bytes(text + b"#")
        after = {stage: digests.package_digest(package / stage, package) for stage in before}
        (package / edited).write_bytes(text)
        assert [stage for stage in before if before[stage] != after[stage]] == again, edited


@pytest.mark.parametrize("name", sorted(digests._LEFT_OUT))
def test_everything_that_is_left_out_is_imported_by_a_stage(name: str):
    less = digests._LEFT_OUT.keys() - {name}
    assert any(len(sources(SOURCE / stage, SOURCE, less)) > len(counted(stage)) for stage in STAGES)


def test_what_a_stage_loads_when_it_runs_is_known_before(tmp_path: Path):
    run = (
        "import sys\nfrom pathlib import Path\n"
        "from motorprior.pipeline.bench import Bench, run_bench\n"
        "from motorprior.pipeline.identify import Identify, run_identify\n"
        "run_bench(Bench(Path('bench'), motors=1, steps=300))\n"
        "run_identify(Identify(Path('bench'), Path('prior'), 'paper_wide', steps=1))\n"
        "print(*(name for name in sys.modules if name.startswith('motorprior.')))"
    )
    done = subprocess.run([sys.executable, "-c", run], cwd=tmp_path, check=True, capture_output=True, text=True)
    known = counted(Path("pipeline", "bench.py")) | counted(Path("pipeline", "identify.py"))
    names = {"motorprior." + name.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for name in known}
    loaded = {name for name in done.stdout.split() if name not in digests._LEFT_OUT}
    assert len(loaded) > 50 and loaded - names <= {"motorprior.pipeline.module_imports", "motorprior.results"}


def test_a_script_counts_with_what_lies_beside_it(tmp_path: Path):
    script, beside, bench = tmp_path / "study.py", tmp_path / "walkers.py", SOURCE / "pipeline" / "bench.py"
    script.write_text("import numpy\nimport walkers\nfrom motorprior.pipeline.bench import run_bench\n")
    beside.write_text("def later():\n    from motorprior.pipeline.bench import run_bench\n")
    known, left_out = sources(bench, SOURCE, digests._LEFT_OUT), digests._LEFT_OUT
    assert set(sources(script, SOURCE, left_out)) == {"study.py", "walkers.py", *known}
    beside.write_text("def later():\n    from motorprior import fit_prior\n")
    assert "motorprior/pipeline/identify.py" in sources(script, SOURCE, left_out), "one of the public names"


def test_a_module_that_another_process_runs_counts():
    assert "motorprior/simulation/render_process.py" in sources(SOURCE / "simulation" / "rendering.py", SOURCE)


@pytest.fixture
def yielding_collector() -> Iterator[None]:
    """Lets other threads run whenever garbage is collected."""

    def give_way(phase: str, info: dict[str, int]) -> None:
        time.sleep(1e-5)

    gc.callbacks.append(give_way)
    yield
    gc.callbacks.remove(give_way)


@pytest.mark.usefixtures("yielding_collector")
def test_stages_of_several_threads_are_digested_together():
    """Libraries add such callbacks; with one, ast.parse of Python 3.11 fails in two threads at a time."""
    stage = SOURCE / "pipeline" / "bench.py"
    module_imports._names.cache_clear()
    with ThreadPoolExecutor(4) as threads:
        found = set(threads.map(lambda _: digests.package_digest(stage, SOURCE), range(8)))
    assert found == {digests.package_digest(stage, SOURCE)}
