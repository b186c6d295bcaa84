"""Every bad input to the functions of meshref is refused in a sentence that names it."""

import importlib
from collections import Counter

from outcomes import assert_all_refused


def test_every_bad_input_is_refused_in_a_sentence_that_names_it():
    assert_all_refused("bad_meshref")


def test_the_corpus_has_thousands_of_distinct_cases():
    modules = [importlib.import_module(f"bad_{package}") for package in ("implicit", "meshref", "compare")]
    names = [case.name for module in modules for case in module.cases()]
    assert [name for name, count in Counter(names).items() if count > 1] == []
    assert len(names) >= 3000
