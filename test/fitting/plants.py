"""Small plants whose parameters are known, and recordings of them by the simulator."""

import numpy as np

from vsensor_ros import load_plant
from vsensor_ros.recordings import Recording, Track
from vsensor_ros.simulate.simulate import readings, simulate

AXIS = """\
# an axis, kept as it is
name: axis
time: continuous
parameters:
  inertia: {value: 0.5, fit: [0.1, 2.0], unit: kg m^2}   # of the load
  drag: {value: 0.3, fit: [0.0, 3.0]}
  dry: {value: 0.1, fit: [0.0, 2.0]}
states:
  angle: {unit: rad}
  speed: {unit: rad/s}
inputs:
  torque: {unit: N m}
dynamics:
  angle: speed
  speed: (torque - drag*speed - dry*sign(speed))/inertia
sensors:
  encoder: {measures: angle, unit: rad}   # four lines a turn
"""
TRUTH = {'inertia': 0.8, 'drag': 0.6, 'dry': 0.4}


def written(folder, text=AXIS, **values):
    """Write a plant file in which parameters have other values."""
    for name, value in values.items():
        head, tail = text.split(f'  {name}: {{value: ', 1)
        text = f'{head}  {name}: {{value: {value}{tail[min(tail.index(c) for c in ",}"):]}'
    path = folder / f'plant{len(list(folder.iterdir()))}.yaml'
    path.write_text(text)
    return path


def torques(count, step, random, size=2.0):
    """Draw steps of half a second each."""
    held = round(0.5 / step)
    return np.repeat(random.uniform(-size, size, count // held + 1), held)[:count]


def recorded(path, u, step=0.02, noise=1e-4, random=None, x0=None):
    """Simulate a plant, and say what its sensors say with noise."""
    plant = load_plant(path)
    random = random or np.random.default_rng(0)
    t = step * np.arange(len(u))
    u = np.reshape(u, (len(t), -1))
    y = readings(plant, t, simulate(plant, t, u, x0=x0), u)
    y = y + noise * random.standard_normal(y.shape)
    return Recording({**{s: Track.of(t, y[:, i]) for i, s in enumerate(plant.sensors)},
                      **{n: Track.of(t, u[:, i]) for i, n in enumerate(plant.inputs)}})
