"""Double precision, checked where it matters and set nowhere: `jax.config` is the caller's."""

import jax


def require_float64(who: str) -> None:
    """Raise `ValueError`, naming `who` asks, unless JAX computes in float64.

    Newton's method on a rod works to 1e-10 of its loads; float32 stalls at 1e-6 and reports
    failures that are none.
    """
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]  # it has it
        raise ValueError(
            f"{who} needs float64, and JAX is set to float32: call "
            'jax.config.update("jax_enable_x64", True) before making any array, or set the '
            "environment variable JAX_ENABLE_X64=1"
        )
