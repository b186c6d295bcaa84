"""The generated corpus of nasty solids: each is mended to its true numbers, or refused; none differs without a word."""

import re

import numpy as np
import pytest
from nasty_solids import Nasty, corpus

from meshref import MeshError, area, check_mesh, genus, mend_mesh, volume

CASES = list(corpus(0))


def differences(case: Nasty) -> list[str]:
    """Return in which numbers the mended mesh differs from what it must be; none where it is refused as it may be."""
    try:
        V, F, report = mend_mesh(case.V, case.F)
        check_mesh(V, F, closed=True)
    except MeshError as error:
        return [] if case.refused and re.search(case.refused, str(error)) else [f"refused: {error}"]
    found = {"volume": volume(V, F), "area": area(V, F), "genus": genus(V, F)}
    found |= {"bodies": report.bodies, "cavities": report.cavities}
    wanted = {name: getattr(case, name) for name in found}
    if np.isnan(case.volume):
        return ["not refused"]
    return [
        f"{name} {found[name]!r} for {wanted[name]!r}"
        for name in found
        if wanted[name] is not None and found[name] != pytest.approx(wanted[name], rel=case.tolerance)
    ]


def test_there_are_sixty():
    assert len(CASES) >= 60
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_a_nasty_solid_has_its_numbers_or_is_refused(case):
    assert differences(case) == []


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(1, 10))
def test_other_nasty_solids_have_their_numbers(seed):
    assert {case.name: found for case in corpus(seed) if (found := differences(case))} == {}
