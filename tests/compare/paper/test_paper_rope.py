"""The rope, quickly: its picture and what it finds."""

import pytest

from compare.paper import Request, draw_parts


# By day the page of the project draws it, in tests/test_readme.py, without a look at its numbers.
@pytest.mark.nightly
def test_a_held_rope_keeps_its_length_and_a_free_one_does_not(tmp_path):
    free, missed_free, held, missed_held = (f.ours for f in draw_parts(Request(tmp_path, quick=True), ["rope"]))
    assert (tmp_path / "rope.png").stat().st_size > 10_000
    assert held == pytest.approx(0, abs=1e-6)
    assert free > 0.02
    assert max(missed_free, missed_held) < 0.05
