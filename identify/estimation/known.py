"""What other logs say of a fit's parameters, as residual rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Known:
    """Parameters as other logs identify them: their values there, SI, and the curvature
    of that fit, in units of the scales, priors counted.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, "k"]
    curvature: Float[np.ndarray, "k k"]

    def rows(
        self,
        columns: Sequence[str | None],
        at: Float[np.ndarray, "columns"],
        scale: Float[np.ndarray, "columns"],
    ) -> tuple[Float[np.ndarray, "columns columns"], Float[np.ndarray, "columns"]]:
        """Residual rows by column, and their value with the columns `at`."""
        sizes, vectors = np.linalg.eigh(self.curvature)
        root = (vectors * np.sqrt(np.maximum(sizes, 0.0))).T
        slope = np.zeros((len(columns), len(columns)))
        away = np.zeros(len(columns))
        for j, name in enumerate(self.names):
            i = columns.index(name)
            slope[: len(root), i] = root[:, j]
            away[i] = (at[i] - self.values[j]) / scale[i]
        return slope, slope @ away
