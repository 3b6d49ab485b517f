"""Set-up of all tests: one thread per process, JAX on the CPU, and the folder of real logs."""

import os

# Before numpy, JAX and matplotlib are imported. NPROC is what sizes XLA's thread pools on the CPU
# (measured: XLA_FLAGS=--xla_cpu_multi_thread_eigen=false alone still keeps two cores busy).
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NPROC"):
    os.environ[_name] = "1"
os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["MPLBACKEND"] = "Agg"
os.environ["COLUMNS"] = "120"  # wider, a long help has two columns
# XLA takes half of the time of all tests: tests, workers, child processes and the next run share
# what it compiled. Entries are keyed by program, flags and versions.
_repository = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
_jax_cache = os.path.join(_repository, ".pytest_cache", "jax")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", _jax_cache)
os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(500 * 2**20))
os.environ.setdefault("JAX_PERSISTENT_COMPILATION_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
# the same code for a fifth less CPU time
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_parallel_codegen_split_count=1")

from collections.abc import Callable  # noqa: E402
from pathlib import Path  # noqa: E402

import pytest  # noqa: E402
from grey_boxes import make_grey_box  # noqa: E402

from motorprior.actuator.grey_box import GreyBox  # noqa: E402

pytest_plugins = ["pytester"]
ROOT = Path(__file__).resolve().parents[1]
SHARED = ("go2", "so101", "xl330", "pupper_v2", "robots", "cases")
LONGEST_FIRST = (
    "commands/test_demo.py",
    "cli/test_adapt.py",
    "identification/test_train.py",
    "cli/test_documented_commands.py",
    "identification/test_recovery.py",
    "identification/evaluation/test_training_errors.py",
    "identification/latents/test_latent_fit.py",
    "identification/physics/test_motor_fit.py",
    "contracts/test_executors.py",
    "identification/networks/test_objectives.py",
    "cli/test_resume.py",
    "cli/test_walk_engines.py",
)
"""Files that start first, so that no worker begins a long one when the others are done."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the longest files first; repeat tests in real time, which a busy machine can fail."""
    items.sort(key=_place)
    for item in items:
        if item.get_closest_marker("real_time"):
            item.add_marker(pytest.mark.flaky(reruns=2))


def _place(item: pytest.Item) -> int:
    path = item.path.relative_to(ROOT / "tests").as_posix()
    return LONGEST_FIRST.index(path) if path in LONGEST_FIRST else len(LONGEST_FIRST)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real logs and models: MOTORPRIOR_SHARED, or `shared/data` next to the checkout.

    Tests that need it are skipped without it.
    """
    folder = Path(os.environ.get("MOTORPRIOR_SHARED") or ROOT.parent / "shared" / "data")
    missing = [name for name in SHARED if not (folder / name).is_dir()]

    if missing:
        pytest.skip(
            f"no real motor logs: {folder} has no {', '.join(missing)}; "
            "set MOTORPRIOR_SHARED to their folder"
        )

    return folder


@pytest.fixture(scope="session")
def grey_box() -> Callable[..., GreyBox]:
    """The function `make_grey_box`."""
    return make_grey_box


@pytest.fixture(scope="session")
def gait_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a training whose policy is the untrained gait."""
    from motorprior.commands.walk import Walk, run_walk

    folder = tmp_path_factory.mktemp("walks") / "gait_0"
    run_walk(Walk(out=folder, motors="pd", iterations=1, episode_steps=5, workers=1))

    return folder
