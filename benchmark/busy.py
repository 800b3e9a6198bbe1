"""Keep one core busy, as the planner or the camera of a robot does."""

while True:
    pass
