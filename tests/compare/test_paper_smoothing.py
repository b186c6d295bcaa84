"""The smoothing figure, quickly: its pictures and what it finds."""

from compare.paper import Request, draw_parts, pictures


def test_the_smoothing_figure_finds_what_is_lost_and_what_is_held(tmp_path):
    findings = {finding.what: finding.ours for finding in draw_parts(Request(tmp_path, quick=True), ["smoothing"])}
    assert findings["spot: volume after 4 steps, nothing held, relative change"] < -0.03
    # Flat meshes of 48 and 64 cells, extrapolated, see no better than this; docs/smoothing.md has the fine figures.
    assert abs(findings["spot: volume drift after 4 steps, volume held"]) < 2e-3
    assert findings["spot: most pieces at any step, nothing held and volume held"] == "1, 1"
    assert len(pictures(tmp_path)) == 4
