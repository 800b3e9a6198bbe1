"""What the user knows of a machine: the plant, made of arrays or read from a plant file."""

from vsensor_ros.plant.load import load_plant
from vsensor_ros.plant.plant import Plant
from vsensor_ros.plant.plant_yaml import read_yaml
from vsensor_ros.plant.sector_nonlinearity import from_equations
from vsensor_ros.plant.takagi_sugeno import grid_memberships, TakagiSugeno
from vsensor_ros.plant.takagi_sugeno_file import load_takagi_sugeno

__all__ = ['Plant', 'TakagiSugeno', 'from_equations', 'grid_memberships', 'load_plant',
           'load_takagi_sugeno', 'read_yaml']
