"""
What the replacer costs and says, and the designer takes, beside peers measured in the same run.

`python -m benchmark` measures and prints; one file a measurement. Linux only: it reads the clocks
of other processes.
"""

import os

# Before numpy is loaded: one run is compared with another, and the cores belong to what is timed.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
