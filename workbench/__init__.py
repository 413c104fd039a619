"""User interfaces: command line, report and web app, based on the same library functions."""

import os

# Set before NumPy is imported: on small matrices more threads double the processor time and save no time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
