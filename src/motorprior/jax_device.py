"""Where JAX computes."""

import jax


def use_cpu_by_default() -> None:
    """Compute on the CPU, unless the user chose a platform (JAX_PLATFORMS or `jax.config`).

    Call it before the first array of JAX is made.
    """
    if not jax.config.jax_platforms:  # pyright: ignore[reportAttributeAccessIssue]
        jax.config.update("jax_platforms", "cpu")
