"""Settings for all tests: examples that do not change from run to run, and no limit on the time of one."""

from hypothesis import settings

settings.register_profile("reproducible", derandomize=True, deadline=None)
settings.load_profile("reproducible")
