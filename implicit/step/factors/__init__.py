"""The inverse of the damped normal matrix of a step, H = A^T W A + D, in three forms.

| form | what is factored | cost, n unknowns and k equations |
|---|---|---|
| Primal | H, by Cholesky | n^2 k to assemble, n^3 / 3 |
| Dual | I + W^1/2 A D^-1 A^T W^1/2, by Cholesky (Woodbury) | n k^2 to assemble, k^3 / 3 |
| ConjugateGradients | nothing | products with H |

All work in float64, whatever the precision of the equations.
"""

from implicit.step.factors.conjugate_gradients import ConjugateGradients
from implicit.step.factors.dual import Dual
from implicit.step.factors.factor import Factor
from implicit.step.factors.primal import Primal

__all__ = ["Factor", "Primal", "Dual", "ConjugateGradients"]
