"""Names of the joints in the log of a bench."""


def bench_names(count: int) -> tuple[str, ...]:
    """Names of the motors on a bench; motors of different benches have the same names."""
    return tuple(f"motor_{index:03d}" for index in range(count))
