"""What the user knows of a machine: the plant, made of arrays or read from a plant file."""

from vsensor_ros.plant.load import load_plant
from vsensor_ros.plant.plant import Plant

__all__ = ['Plant', 'load_plant']
