"""The operations, one object and one file each: default handles, settings, editors, error and headline.

Importing them is quick, and they are imported with `compare`, for a case can name those only that are registered.
"""

from compare.operations.geometric import Geometric
from compare.operations.operation import Operation, operation_of, operations, register
from compare.operations.rigid import Rigid
from compare.operations.smooth import Smooth

for _operation in (Geometric(), Smooth(), Rigid()):  # in the order in which they are run and shown
    register(_operation)

__all__ = ["Operation", "operation_of", "operations", "register", "Geometric", "Smooth", "Rigid"]
