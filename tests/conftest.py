"""Set-up of every test: one thread per process, JAX on the CPU, and where the real motor logs are."""

import os

# Before numpy, JAX and matplotlib are imported. NPROC is what sizes XLA's thread pools on the CPU
# (measured: XLA_FLAGS=--xla_cpu_multi_thread_eigen=false alone still keeps two cores busy).
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NPROC"):
    os.environ[_name] = "1"
os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["MPLBACKEND"] = "Agg"
os.environ["COLUMNS"] = "120"  # wider, a long help has two columns
# Half of all tests' time is XLA's: what one test, worker or child process compiled is there for the
# others, and for the next run. Entries are keyed by program, flags and versions.
for _name, _value in {
    "DIR": os.path.join(
        os.path.dirname(os.path.dirname(os.path.abspath(__file__))), ".pytest_cache", "jax"
    ),
    "MAX_SIZE": str(500 * 2**20),
}.items():
    os.environ.setdefault(f"JAX_COMPILATION_CACHE_{_name}", _value)
os.environ.setdefault("JAX_PERSISTENT_COMPILATION_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
# a fifth less CPU, same code
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_parallel_codegen_split_count=1")

from collections.abc import Callable  # noqa: E402
from pathlib import Path  # noqa: E402

import pytest  # noqa: E402
from grey_boxes import make_grey_box  # noqa: E402

from motorprior.actuator.grey_box import GreyBox  # noqa: E402

pytest_plugins = ["pytester"]
ROOT = Path(__file__).resolve().parents[1]
SHARED = ("go2", "so101", "xl330", "pupper_v2", "robots")
LONGEST_FIRST = (
    "commands/test_demo.py", "cli/test_adapt.py",
    "identification/test_train.py", "cli/test_documented_commands.py", "identification/test_recovery.py",
    "identification/evaluation/test_reference.py", "identification/latents/test_latent_fit.py",
    "identification/physics/test_motor_fit.py", "contracts/test_executors.py",
    "identification/networks/test_objectives.py", "cli/test_resume.py", "cli/test_walk_engines.py",
)  # fmt: skip
"""A worker that begins one of these last keeps the others waiting."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first. Tests in real time are repeated: a busy machine can fail them."""
    items.sort(key=_place)
    for item in items:
        if item.get_closest_marker("real_time"):
            item.add_marker(pytest.mark.flaky(reruns=2))


def _place(item: pytest.Item) -> int:
    path = item.path.relative_to(ROOT / "tests").as_posix()
    return LONGEST_FIRST.index(path) if path in LONGEST_FIRST else len(LONGEST_FIRST)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real motor logs and models, from MOTORPRIOR_SHARED or `shared/data` beside the checkout, or skip."""
    folder = Path(os.environ.get("MOTORPRIOR_SHARED") or ROOT.parent / "shared" / "data")
    if missing := [name for name in SHARED if not (folder / name).is_dir()]:
        pytest.skip(
            f"no real motor logs: {folder} has no {', '.join(missing)}; MOTORPRIOR_SHARED names their folder"
        )
    return folder


@pytest.fixture(scope="session")
def grey_box() -> Callable[..., GreyBox]:
    """See `make_grey_box`."""
    return make_grey_box


@pytest.fixture(scope="session")
def gait_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a walk, the gait itself."""
    from motorprior.commands.walk import Walk, run_walk

    folder = tmp_path_factory.mktemp("walks") / "gait_0"
    run_walk(Walk(out=folder, motors="pd", iterations=1, episode_steps=5, workers=1))
    return folder
