"""The list of mutations fits the sources: each changes a text that is there exactly once, and names a test there is."""

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SPEC = importlib.util.spec_from_file_location("mutations", ROOT / "tests" / "mutations.py")
mutations = importlib.util.module_from_spec(SPEC)
sys.modules["mutations"] = mutations  # where its dataclass looks for its types
SPEC.loader.exec_module(mutations)


def test_each_mutation_changes_one_place():
    for mutation in mutations.MUTATIONS:
        assert (ROOT / mutation.path).read_text().count(mutation.old) == 1, mutation
        assert mutation.new != mutation.old


def test_each_mutation_names_a_test_that_is_there():
    for mutation in mutations.MUTATIONS:
        path, name = mutation.test.split("::")
        assert f"def {name}(" in (ROOT / path).read_text(), mutation


def test_the_page_shows_just_these_mutations_and_all_of_them_caught():
    page = (ROOT / "docs" / "mutations.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith(("| implicit/", "| meshref/"))]
    assert rows == mutations._table([(mutation, True) for mutation in mutations.MUTATIONS]).splitlines()[2:]
