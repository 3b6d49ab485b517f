"""A prior that several tests of benchmarks use."""

from pathlib import Path

import pytest

from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify


@pytest.fixture(scope="session")
def bench_prior(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a prior of twelve motors, identified from a bench."""
    root = tmp_path_factory.mktemp("bench_prior")
    run_bench(Bench(root / "bench", motors=12, steps=2000))
    run_identify(Identify((root / "bench",), root / "prior", "pace"))
    return root / "prior" / "prior.safetensors"
