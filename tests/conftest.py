"""Settings for all tests: examples that do not change from run to run, and no limit on the time of one."""

import os

from hypothesis import settings

# OpenMP reads it when torch is imported; see compare.commands.cli.main.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
if "PYTEST_XDIST_WORKER" in os.environ:  # there is a process a core already
    os.environ.setdefault("OMP_NUM_THREADS", "1")

settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")
