"""Tests, one process of them per core: more threads would only wait for each other."""

import os

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1"}  # read as these are imported
