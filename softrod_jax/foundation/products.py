"""Products of many small matrices, in the way that suits the device.

A library's product of small matrices reads and writes all of them by itself, and on a GPU bytes are
the time. Written out in components it is one kernel with what stands around it.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Inexact

from softrod_jax.foundation.compiling import on_cpu


def product(A, B) -> Float[Array, "*batch n k"]:
    """A @ B of (*batch, n, m) and (*batch, m, k)."""
    return A @ B if on_cpu() else product_in_components(A, B)


def product_in_components(A, B) -> Float[Array, "*batch n k"]:
    """The same, as a sum of outer products."""
    terms = (A[..., :, j, None] * B[..., j, None, :] for j in range(A.shape[-1]))
    return sum(terms)  # pyright: ignore[reportReturnType]  # there is a term


def precision() -> str | None:
    """Of products with vectors: a GPU may round numbers in float32 to fewer digits."""
    return None if on_cpu() else "highest"


def weighted_sum(weights, values) -> Inexact[Array, "*rest"]:
    """sum_i weights_i values_i."""
    if on_cpu():
        return jnp.tensordot(weights, values, 1)
    terms = [weights[i] * values[i] for i in range(len(weights))]
    return sum(terms)  # pyright: ignore[reportReturnType]  # there is a term
