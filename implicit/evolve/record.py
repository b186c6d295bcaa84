"""The record of one step: the columns of an edit's history that every operation shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

from implicit.evolve.trial import Trial
from implicit.step.problem import Row


@dataclass(frozen=True)
class StepRecord:
    """The loop's record of a step.

    Attributes:
        constraint_gap: Largest relative distance of a functional from its target or bound, as measured.
        constraint_error: Estimate of the largest relative error of these measurements, at the start and now together.
        residual, objective, condition, rank, damping, method: Of the solution, see Solution.
        largest_motion: Longest predicted motion of a tracked point, a length.
        linearity_error: Root mean square of achieved minus predicted motion over that of the predicted one.
        d_theta_norm: Euclidean norm of the change of the parameters.
        points_lost: Tracked points that did not reach the moved surface.
        solve_status: How the solve ended, a sentence.
        solves: Tries of the damping.
        seconds_solve: Wall time of these.
    """

    constraint_gap: float
    constraint_error: float
    residual: float
    objective: float
    condition: float
    rank: float
    damping: float
    method: str
    largest_motion: float
    linearity_error: float
    d_theta_norm: float
    points_lost: int
    solve_status: str
    solves: int
    seconds_solve: float

    @classmethod
    def of(
        cls,
        trial: Trial,
        *,
        constraint_gap: float,
        constraint_error: float,
        largest_motion: float,
        d_theta_norm: float,
        points_lost: int,
        seconds_solve: float,
    ) -> StepRecord:
        """Return the record of an accepted trial and of what became of it."""
        solution = trial.solution
        return cls(
            constraint_gap=constraint_gap,
            constraint_error=constraint_error,
            residual=solution.residual,
            objective=solution.objective,
            condition=solution.condition,
            rank=solution.rank,
            damping=solution.damping,
            method=solution.method,
            largest_motion=largest_motion,
            linearity_error=trial.error.relative,
            d_theta_norm=d_theta_norm,
            points_lost=points_lost,
            solve_status=solution.status.value,
            solves=trial.solves,
            seconds_solve=seconds_solve,
        )


# Of the rows of every history, beside those of the operation and of the functionals that are held.
COLUMNS = ("step", "components", "euler", "event", *(column.name for column in fields(StepRecord)), "seconds")


def history_row(
    number: int, operation: Row, topology: Row, values: Mapping[str, float], record: StepRecord, seconds: float
) -> Row:
    """Return a row of the history, whose columns are in the order of the arguments.

    A volume or area that is held takes the place of the operation's own; other names are apart, see ConstraintSet.of.

    Args:
        number: Of the step, from 1 on.
        operation: What the operation records.
        topology: The same of the pieces, see topology_row.
        values: Of the functionals that are held.
        record: What the loop records.
        seconds: Wall time of the step.
    """
    return {"step": number, **operation, **topology, **values, **asdict(record), "seconds": seconds}
