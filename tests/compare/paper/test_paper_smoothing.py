"""The smoothing figure, quickly: its pictures and what it finds."""

import pytest

from compare.paper import Request, draw_parts, pictures


@pytest.mark.nightly
def test_the_smoothing_figure_finds_what_is_lost_and_what_is_held(tmp_path):
    findings = {finding.what: finding.ours for finding in draw_parts(Request(tmp_path, quick=True), ["smoothing"])}
    change = "after 4 steps: volume, relative change [of that before]"
    assert findings[f"spot, neural, nothing held, {change}"] < -0.03
    # Flat meshes of 48 and 64 cells, extrapolated, see no better than this; docs/smoothing.md has the fine figures.
    assert abs(findings[f"spot, neural, volume held, {change}"]) < 2e-3
    pieces = [ours for what, ours in findings.items() if "most pieces" in what]
    assert pieces == [1, 1]
    assert len(pictures(tmp_path)) == 4
