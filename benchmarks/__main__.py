"""`python -m benchmarks`: starts the suite with the linear algebra on one thread, as OpenCV is."""

import os

# Before numpy is loaded: no contender gets help from threads that the others do not have.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

from benchmarks.suite import main  # noqa: E402

if __name__ == "__main__":
    main()
