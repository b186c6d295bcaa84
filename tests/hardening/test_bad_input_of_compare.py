"""Every bad input to the functions of compare and of the command is refused in a sentence that names it."""

from outcomes import assert_all_refused


def test_every_bad_input_is_refused_in_a_sentence_that_names_it():
    assert_all_refused("bad_compare")
