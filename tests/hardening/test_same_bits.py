"""One seed gives one result, to the bit: twice in one process, and in two processes with different hash seeds."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest


def hashes(hash_seed, times):
    """What bits.py prints: so many hashes for each operation."""
    result = subprocess.run(
        [sys.executable, str(Path(__file__).with_name("bits.py")), str(times)],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "PYTHONHASHSEED": str(hash_seed), "OMP_NUM_THREADS": "1"},
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


@pytest.mark.parametrize("times", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_one_seed_gives_one_result_to_the_bit(times):
    here, there = hashes(1, times), hashes(2, times=1)
    assert [name for name, found in here.items() if len(set(found)) > 1] == []
    assert [name for name in here if here[name][0] != there[name][0]] == []
    assert len({found[0] for found in here.values()}) == len(here)
