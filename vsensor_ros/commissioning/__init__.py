"""Before the first drive: what is looked at, and written down, while nothing is published."""
