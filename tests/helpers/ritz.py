"""An inextensible rod in a plane by energies alone, as a check of equilibria and small motions.

The angle of the axis is a polynomial, theta(s) = sum a_k phi_k(s) with theta(0) = 0; positions are
integrals of its sine and cosine. Rayleigh and Ritz: equilibria are where the potential is
stationary, and small motions follow from its Hessian and the kinetic energy. Nothing is integrated
along the rod, and the errors fall exponentially with the degree.
"""

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg


class Ritz:
    """A cantilever along z; `gravity` and `force` at the tip are in the plane, (x, z)."""

    def __init__(self, L, EI, rho_A, rho_I, B=0.0, payload=0.0, gravity=(0, 0), force=(0, 0)):
        self.L, self.EI, self.rho_A, self.rho_I, self.B = L, EI, rho_A, rho_I, B
        self.payload, self.gravity = payload, np.array(gravity, float)
        self.force = np.array(force, float)
        degree, points = 13, 40
        x, w = np.polynomial.legendre.leggauss(points)
        self.w = w * L / 2
        fit = np.linalg.inv(np.polynomial.legendre.legvander(x, points - 1))
        integrals = np.eye(points)
        antiderivative = np.stack([np.polynomial.legendre.legint(c, lbnd=-1) for c in integrals], 1)
        ends = np.append(x, 1.0)
        self.integral = (
            np.polynomial.legendre.legvander(ends, points) @ antiderivative @ fit * L / 2
        )
        # phi_k' are Legendre's polynomials, so that theta vanishes at the clamp.
        self.slope = np.polynomial.legendre.legvander(x, degree)
        self.phi = (self.integral @ self.slope)[:-1]

    def positions(self, a):
        """Of all quadrature points, and of the tip, (points + 1, 2)."""
        theta = self.phi @ a
        return self.integral @ jnp.stack([jnp.sin(theta), jnp.cos(theta)], 1)

    def potential(self, a):
        p, bend = self.positions(a), self.slope @ a
        elastic = 0.5 * self.EI * self.w @ bend**2
        dead = self.rho_A * self.w @ (p[:-1] @ self.gravity)
        return elastic - dead - p[-1] @ (self.payload * self.gravity + self.force)

    def equilibrium(self):
        """Newton's method, from the equilibrium under a part of the loads to that under more."""
        loaded = lambda a, part: part * self.potential(a) + (1 - part) * self._elastic(a)
        gradient, hessian = jax.jit(jax.grad(loaded)), jax.jit(jax.hessian(loaded))
        a = jnp.zeros(self.phi.shape[1])
        for part in np.linspace(0, 1, 9)[1:]:
            for _ in range(8):
                a = a - jnp.linalg.solve(hessian(a, part), gradient(a, part))
        return a

    def _elastic(self, a):
        return 0.5 * self.EI * self.w @ (self.slope @ a) ** 2

    def matrices(self):
        """M, C and K of small motions about the equilibrium."""
        a = self.equilibrium()
        K = np.asarray(jax.hessian(self.potential)(a))
        J = np.asarray(jax.jacfwd(self.positions)(a))
        M = self.rho_A * np.einsum("n,nia,nib->ab", self.w, J[:-1], J[:-1])
        M += self.payload * np.einsum("ia,ib->ab", J[-1], J[-1])
        M += self.rho_I * np.einsum("n,na,nb->ab", self.w, self.phi, self.phi)
        C = self.B * np.einsum("n,na,nb->ab", self.w, self.slope, self.slope)
        return M, C, K

    def poles(self, count):
        """The slowest, with imaginary parts that are not negative."""
        M, C, K = self.matrices()
        n = len(M)
        zero, one = np.zeros((n, n)), np.eye(n)
        A = np.block([[zero, one], [-K, -C]])
        poles = scipy.linalg.eigvals(A, np.block([[one, zero], [zero, M]]))
        poles = poles[poles.imag >= 0]
        return poles[np.argsort(np.abs(poles))][:count]
