"""What control asks of whatever knows the body: the network, or wires on the skeleton."""

from __future__ import annotations

from typing import Protocol

from services.body_schema.network import Array


class BodyModel(Protocol):
    """How long the muscles are, and how that changes with the joints: N joints, M muscles."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names (N,)."""

    @property
    def muscles(self) -> tuple[str, ...]:
        """Names (M,)."""

    def lengths(self, theta: Array, f: Array) -> Array:
        """Theta (N,) [rad], f (M,) [N] -> l (M,) [m]; or (B, N), (B, M) -> (B, M)."""

    def lengths_jacobian(self, theta: Array, f: Array) -> Array:
        """dl/dtheta (M, N) [m/rad] at theta (N,) [rad], f (M,) [N], f held."""

    def lengths_and_jacobian(self, theta: Array, f: Array) -> tuple[Array, Array]:
        """L (M,) [m] and dl/dtheta (M, N) [m/rad] at theta (N,) [rad], f (M,) [N]."""
