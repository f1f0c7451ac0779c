"""What annotations call the numbers that users give: those of JAX and of numpy, and Python's own.

What is computed with are arrays of JAX, `Float[Array, ..]` with the names of their axes. What is
given may be anything that `jnp.asarray` makes such an array of; the calls do that, not the classes.
So a scene has what it was given until a call takes it. A batch of scenes has a first axis.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Real

ScalarLike = Real[Array | np.ndarray, "..."] | float | np.number
# One number, or one for each of x, y, z.
DiagonalLike = ScalarLike | Sequence[ScalarLike]
PairLike = Real[Array | np.ndarray, "... 2"] | Sequence[ScalarLike]
VectorLike = Real[Array | np.ndarray, "... 3"] | Sequence[ScalarLike]
QuaternionLike = Real[Array | np.ndarray, "... 4"] | Sequence[ScalarLike]
# One number, or one row of numbers, for each of several; and rows in time of these.
ManyLike = Real[Array | np.ndarray, "..."] | Sequence[ScalarLike]
RowsLike = Real[Array | np.ndarray, "..."] | Sequence[ManyLike]
