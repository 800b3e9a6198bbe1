"""A plant file to begin with: from a template, masses and lengths, a URDF, or data alone."""

from vsensor_ros.first_plant.arm import Arm, arm_plant
from vsensor_ros.first_plant.black_box import black_box, BlackBox, box_lines, box_text
from vsensor_ros.first_plant.templates import checked_name, filled, number, templates
from vsensor_ros.first_plant.urdf import urdf_plant
from vsensor_ros.first_plant.written import write_plant

__all__ = ['Arm', 'BlackBox', 'arm_plant', 'black_box', 'box_lines', 'box_text', 'checked_name',
           'filled', 'number', 'templates', 'urdf_plant', 'write_plant']
