"""User interfaces: command line, report and web app, based on the same library functions."""

import os

# Matrices are small: more threads take twice the processor time and end no sooner. NumPy looks when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
