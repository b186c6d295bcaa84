"""The list of mutations fits the sources, its page is that of runs on them, and three at random are caught."""

import subprocess
import sys

import mutations


def test_each_mutation_changes_one_place_of_its_function():
    for mutation in mutations.MUTATIONS:
        assert mutation.mutated() != (mutations.ROOT / mutation.path).read_text(), mutation


def test_each_mutation_names_a_test_that_is_there():
    for mutation in mutations.MUTATIONS:
        path, name = mutation.test.split("::")
        assert f"def {name}(" in (mutations.ROOT / path).read_text(), mutation


def test_the_page_is_that_of_runs_on_these_sources_with_all_of_them_caught():
    results = mutations.stored()
    current = [known for m in mutations.MUTATIONS if (known := mutations.is_known(m, results))]
    stale = [result.formula for result in results if result not in current]
    assert stale == [], "Run python tests/mutations.py --write: the sources of these have changed since they were run."
    assert len(current) == len(mutations.MUTATIONS), "Run python tests/mutations.py --write: some were not run yet."
    assert [result.formula for result in results if not result.caught] == []
    assert mutations.PAGE.read_text() == mutations.page(results)


def test_a_mutation_at_random_is_caught():
    """The same one for the same sources, so another with each change; the seed is printed."""
    result = subprocess.run(
        [sys.executable, mutations.ROOT / "tests" / "mutations.py", "--random", "1", "--processes", "1"],
        capture_output=True,
        text=True,
        check=False,
    )
    print(result.stdout)
    assert result.returncode == 0, result.stdout + result.stderr
    assert "1 of 1 caught." in result.stdout


def test_a_text_that_is_twice_in_a_file_is_found_by_its_function(tmp_path, monkeypatch):
    monkeypatch.setattr(mutations, "ROOT", tmp_path)
    (tmp_path / "a.py").write_text("def f():\n    return 1\n\n\nclass A:\n    def f(self):\n        return 1\n")
    of_method = mutations.Mutation("one", "a.py", "A.f", "return 1", "return 2", "")
    assert of_method.mutated() == (tmp_path / "a.py").read_text()[:-2] + "2\n"
    assert of_method.where() == "A.f"
