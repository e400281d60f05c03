"""The nodes' own unknowns as a chain: each is tied to its neighbours alone.

So they are eliminated in time linear in their number: a block tridiagonal system solved as a band,
and a Schur complement of what they share (Triggs et al., 2000).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray

LOCAL = 4
"""Unknowns of a node: yaw and three of street. Neighbours are tied yaw to yaw and axis to axis,
so the band is as wide as one node."""


@dataclass(frozen=True, eq=False)
class Chain:
    """Normal equations of a chain and of what its nodes share."""

    blocks: FloatArray
    """Information of each node on itself. Shape (n, 4, 4)."""
    ties: FloatArray
    """Diagonal of the information between each node and the next. Shape (n - 1, 4)."""
    coupling: FloatArray
    """Information between each node and what is shared. Shape (n, 4, g)."""
    shared: FloatArray
    """Information on what is shared. Shape (g, g)."""
    local_gradient: FloatArray
    shared_gradient: FloatArray
    """Downhill. Shape (n, 4)."""


@dataclass(frozen=True, eq=False)
class Eliminated:
    """A chain's unknowns taken out."""

    shared_step: FloatArray
    local_step: FloatArray
    """To the optimum of the normal equations. Shape (g,)."""
    information: FloatArray
    """Schur complement: what is known of the shared numbers. Shape (g, g)."""
    follow: FloatArray
    """How the nodes follow the shared numbers, with the sign reversed. Shape (n, 4, g)."""


def eliminate(chain: Chain) -> Eliminated | None:
    """Solve the normal equations; None where they are not positive definite."""
    # Loaded only by who fits a drive: it takes longer than all the rest of the package.
    from scipy.linalg import cho_solve_banded, cholesky_banded

    n, g = len(chain.blocks), len(chain.shared)
    band = np.zeros((LOCAL + 1, LOCAL * n))
    for row in range(LOCAL):
        for column in range(row + 1):
            band[row - column, column::LOCAL] = chain.blocks[:, row, column]
    band[LOCAL, : LOCAL * (n - 1)] = chain.ties.ravel()
    right = np.empty((LOCAL * n, g + 1))
    right[:, :g] = chain.coupling.reshape(-1, g)
    right[:, g] = chain.local_gradient.ravel()
    try:
        factor = cholesky_banded(band, lower=True, check_finite=False)
        solved = cho_solve_banded((factor, True), right, check_finite=False)
        cross = right[:, :g].T @ solved
        information = np.asarray(chain.shared - cross[:, :g], dtype=np.float64)
        # Only to find out whether it is positive definite.
        np.linalg.cholesky(0.5 * (information + information.T))
    except np.linalg.LinAlgError:
        return None
    left = chain.shared_gradient - cross[:, g]
    shared = np.asarray(np.linalg.solve(information, left), dtype=np.float64)
    local = solved[:, g] - solved[:, :g] @ shared
    follow = solved[:, :g].reshape(n, LOCAL, g)
    return Eliminated(shared, local.reshape(n, LOCAL), information, follow)


def own_covariances(chain: Chain) -> tuple[FloatArray, FloatArray]:
    """Return each node's covariance, and that with the next, what is shared held.

    Two recursions over the blocks (Takahashi et al., 1973).

    Returns
    -------
    ndarray, ndarray, shape (n, 4, 4), (n - 1, 4, 4)
    """
    n, ties = len(chain.blocks), chain.ties
    inverse = np.empty((n, LOCAL, LOCAL))
    inverse[0] = np.linalg.inv(chain.blocks[0])
    for k in range(1, n):
        tie = ties[k - 1]
        inverse[k] = np.linalg.inv(chain.blocks[k] - tie[:, None] * inverse[k - 1] * tie[None, :])
    own = np.empty_like(inverse)
    between = np.empty((max(n - 1, 0), LOCAL, LOCAL))
    own[-1] = inverse[-1]
    for k in range(n - 2, -1, -1):
        gain = inverse[k] * ties[k][None, :]
        between[k] = -gain @ own[k + 1]
        own[k] = inverse[k] - between[k] @ gain.T
    return own, between
