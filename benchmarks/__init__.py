"""Cost and accuracy side by side, for asv: `time_`, `peakmem_` with an empty baseline, and `track_` for errors.

One file an area. Each is measured on one thread, for times on several depend on what else the machine does.
"""

import os

# Read by numpy and torch when they are imported, which is later.
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
