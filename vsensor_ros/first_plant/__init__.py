"""A plant file to begin with: from a template, masses and lengths, a URDF, or data alone."""

from vsensor_ros.first_plant.templates import filled, templates
from vsensor_ros.first_plant.written import write_plant

__all__ = ['filled', 'templates', 'write_plant']
