"""Set-up of every test: one thread per process, JAX on the CPU, and where the real motor logs are."""

import os

# Before numpy, JAX and matplotlib are imported. NPROC is what sizes XLA's thread pools on the CPU
# (measured: XLA_FLAGS=--xla_cpu_multi_thread_eigen=false alone still keeps two cores busy).
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NPROC"):
    os.environ[_name] = "1"
os.environ["JAX_PLATFORMS"] = "cpu"
os.environ["MPLBACKEND"] = "Agg"

from pathlib import Path  # noqa: E402

import pytest  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real motor logs (`pupper_v2/`, `so101/`, `xl330/`); the test is skipped without it.

    MOTORPRIOR_SHARED names it; without the variable it is a folder `shared/data` beside the checkout.
    """
    folder = Path(os.environ.get("MOTORPRIOR_SHARED") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip("no real motor logs: MOTORPRIOR_SHARED names their folder, or shared/data beside the checkout")
    return folder
