"""Linear models of a robot about an equilibrium, for control: descriptor and state-space form."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float, Real

from softrod_jax.analysis.inputs_and_outputs import Chosen, applied_by, at_equilibrium
from softrod_jax.analysis.near_rest import NearRest
from softrod_jax.analysis.seen import observed
from softrod_jax.analysis.truncation import balanced, slowest
from softrod_jax.bvp.method import AbstractMethod
from softrod_jax.bvp.newton import NewtonOptions
from softrod_jax.foundation.compiling import compiled
from softrod_jax.foundation.numbers import ScalarLike
from softrod_jax.scene.inputs import Inputs, whole_number
from softrod_jax.scene.scene import Scene
from softrod_jax.statics import StaticSolution

_REDUCTIONS = {"balance": balanced, "speed": slowest}


class LinearModel(eqx.Module):
    """E x_t = A x + B u, y = C x + D u: small changes about an equilibrium.

    - `E`, `A`, (n, n), `B`, (n, m), `C`, (p, n), `D`, (p, m). `inputs` and `outputs`: a name with
      its unit for each of u and y, which are differences to their values in the equilibrium.
    - `equilibrium`: the `StaticSolution`; `u0`, (m,), and `y0`, (p,): the inputs and the outputs
      there. Rotations are zero there.

    As `linearise` makes it, it is a descriptor model: E is singular, for it has all strains and
    velocities along the rod, many of which follow from others at once. `reduced` is a model in
    state space, with E = 1, of few states.
    """

    E: Float[Array, "n n"]
    A: Float[Array, "n n"]
    B: Float[Array, "n m"]
    C: Float[Array, "p n"]
    D: Float[Array, "p m"]
    equilibrium: StaticSolution
    u0: Float[Array, "m"]
    y0: Float[Array, "p"]
    inputs: tuple[str, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    descriptor: bool = eqx.field(static=True, default=True)

    @property
    def static_gain(self) -> Float[Array, "p m"]:
        """The outputs in the end, under constant inputs, for each of them."""
        return self.D - self.C @ jnp.linalg.solve(self.A, self.B)

    def frequency_response(self, omega: Real[Array | np.ndarray, "k"]) -> Complex[Array, "k p m"]:
        """y over u at angular frequencies `omega` [rad/s]."""

        def at(w):
            return self.D + self.C @ jnp.linalg.solve(1j * w * self.E - self.A, self.B + 0j)

        return jax.lax.map(at, jnp.asarray(omega, dtype=float))

    def reduced(self, states: int, by: str = "balance") -> "LinearModel":
        """A model of few states with E = 1 and the same static gain. Not under `jit`.

        - `by` "balance": the states that inputs reach and outputs see most.
        - `by` "speed": those of the slowest poles; a pair of conjugate ones stays together, with
          `states` or one less. In a rod that creeps back more than it swings, what matters is not
          what is slowest.

        Raises `ValueError` for less than one state, more than there are, or another `by`.
        """
        states = whole_number("LinearModel.reduced", "states", states)
        if by not in _REDUCTIONS:
            raise ValueError(f'LinearModel.reduced: by={by!r}; use "balance" or "speed"')
        E, A, B, C, D = (np.asarray(x) for x in (self.E, self.A, self.B, self.C, self.D))
        try:
            small = _REDUCTIONS[by](np.linalg.solve(A, E), np.linalg.solve(A, B), C, D, states)
        except ValueError as e:
            raise ValueError(f"LinearModel.reduced: {e}") from None
        A, B, C, D = map(jnp.asarray, small)
        # What rounding has changed of the static gain.
        D = D + self.static_gain - (D - C @ jnp.linalg.solve(A, B))
        eye = jnp.eye(A.shape[0])
        return dataclasses.replace(self, E=eye, A=A, B=B, C=C, D=D, descriptor=False)

    def discrete(self, dt: ScalarLike) -> tuple[Float[Array, "n n"], Float[Array, "n m"]]:
        """F and G of x(t + dt) = F x + G u with a constant u in between, of a model with E = 1."""
        if self.descriptor:
            raise ValueError("LinearModel.discrete: E is singular; take model.reduced(states)")
        n, m = self.B.shape
        both = jnp.zeros((n + m, n + m)).at[:n].set(jnp.concatenate([self.A, self.B], 1))
        both = jax.scipy.linalg.expm(both * dt)
        return both[:n, :n], both[:n, n:]

    def response(
        self, dt: ScalarLike, u: Real[Array | np.ndarray, "steps m"]
    ) -> Float[Array, "times p"]:
        """Outputs, (steps + 1, p), from rest; row k of `u` acts from k dt to (k + 1) dt.

        Entry k + 1 is that at the end of row k, entry 0 is zero. Raises `ValueError` for a
        descriptor model.
        """
        F, G = self.discrete(dt)

        def step(x, u):
            x = F @ x + G @ u
            return x, self.C @ x + self.D @ u

        _, y = jax.lax.scan(step, jnp.zeros(F.shape[0]), jnp.asarray(u, dtype=float))
        return jnp.concatenate([jnp.zeros_like(y[:1]), y])


def linearise(
    scene: Scene,
    tensions: Real[Array | np.ndarray, "by_tension"] | Sequence[ScalarLike] | None = None,
    pressures: Real[Array | np.ndarray, "chambers"] | Sequence[ScalarLike] | None = None,
    pulls: Real[Array | np.ndarray, "by_length"] | Sequence[ScalarLike] | None = None,
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] = ("tip",),
    before: StaticSolution | None = None,
    method: AbstractMethod | None = None,
    newton: NewtonOptions = NewtonOptions(),
    throw: bool = True,
) -> LinearModel:
    """The linear model of `scene` about its equilibrium under these inputs.

    It is exact for the discretisation along the rod: a small motion of `simulate` on the same
    `method` is its motion, as far as steps in time resolve it. Square-law drag has no part in it.

    - `tensions`, `pressures`, `pulls`, `before`, `method`, `newton`, `throw`: as of `solve_static`,
      but that actuators which are not given have zero.
    - `inputs`: of the model, some of "tensions", "pressures", "pulls", "tip_force" [N] and
      "tip_moment" [N m] (base frame). `None`: all actuators of the scene or, without any,
      the force at the tip.
    - `outputs`: "tip", or the name of a marker, its position [m] and rotation [rad] about the axes
      of the base; "strains" at the nodes; "base_wrench", the total force [N] and moment [N m] of
      rod and tendons on what carries them, base frame; "tensions" of all tendons.

    Raises `ValueError` for what `solve_static` does, for other names, and for what has no
    derivative at rest: dry friction, of tendons or contacts, and backlash. A tendon that is driven
    by its length stays slack, or taut, as it is.
    """
    acting = Inputs(tensions, pressures, pulls)
    chosen = Chosen("linearise", inputs, outputs)
    solving = dict(before=before, method=method, newton=newton, throw=throw)
    near, names, solution = at_equilibrium(scene, acting, chosen, **solving)
    E, B, C, D, u0, y0 = _matrices(near, names.inputs, names.outputs)
    eye = jnp.eye(E.shape[0])
    return LinearModel(E, eye, B, C, D, solution, u0, y0, names.of_inputs, names.of_outputs)


@compiled
def _matrices(near: NearRest, inputs: tuple[str, ...], outputs: tuple[str, ...]):
    """E, B, C, D, u0 and y0 of the model: its state is that with a history, and the outputs."""
    ravel = lambda x: ravel_pytree(x)[0]
    rest, as_rates = ravel_pytree(near.at_rest)
    applied, u0 = applied_by(near, inputs)
    m = u0.size
    n, values = rest.size, observed(near, outputs)

    def seen(unknowns, rates, applied):
        fields, along = near.fields(unknowns, rates, applied)
        return jnp.concatenate([ravel(fields), values(along, applied)])

    columns = near.along(
        jnp.eye(n + m),
        seen,
        near.following(),
        lambda z: as_rates(z[:n]),
        lambda z: applied(z[n:]),
    ).T
    p = columns.shape[0] - n
    E = jnp.concatenate([columns[:, :n], jnp.zeros((n + p, p))], 1)
    y0 = seen(near.unknowns, near.at_rest, near.applied)[n:]
    return E, -columns[:, n:], jnp.eye(p, n + p, n), jnp.zeros((p, m)), u0, y0
