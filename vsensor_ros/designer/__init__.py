"""What can be promised: the search for virtual sensors (the desk's wing)."""

from vsensor_ros.designer.design import design

__all__ = ['design']
