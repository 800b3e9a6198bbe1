"""
What the replacer costs, beside a peer that is measured in the same run.

`python -m benchmark` measures and prints; one file a measurement. Linux only: it reads the clocks
of other processes.
"""
