"""What holds for every test: one thread of torch, in subprocesses too, and no judgement by the
clock.
"""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

# Read when torch and BLAS are first imported: many threads on few cores make tiny networks a
# hundred times slower.
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"

# The same examples on every machine, however busy it is.
settings.register_profile(
    "mapdata",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("mapdata")
