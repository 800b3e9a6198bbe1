"""
Replace failed sensors by virtual ones, designed offline and run over ROS 2 topics.

The names below are loaded when first used, so that the runtime on the machine never loads the
designer.
"""

from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from vsensor_ros.control import closed_loop, Controller, load_controller
    from vsensor_ros.designer import design
    from vsensor_ros.observers import Design, Refusal, VirtualSensor
    from vsensor_ros.plant import load_plant, Plant
    from vsensor_ros.recordings import load_dataset, Recording

__all__ = ['Controller', 'Design', 'Plant', 'Recording', 'Refusal', 'VirtualSensor',
           'closed_loop', 'design', 'load_controller', 'load_dataset', 'load_plant']


def __getattr__(name: str) -> Any:
    """Load one of the public names from the room it lives in (PEP 562)."""
    if name == 'design':
        from vsensor_ros.designer import design
        return design
    if name in ('Controller', 'closed_loop', 'load_controller'):
        from vsensor_ros import control
        return getattr(control, name)
    if name in ('Plant', 'load_plant'):
        from vsensor_ros import plant
        return getattr(plant, name)
    if name in ('Recording', 'load_dataset'):
        from vsensor_ros import recordings
        return getattr(recordings, name)
    if name in ('Design', 'Refusal', 'VirtualSensor'):
        from vsensor_ros import observers
        return getattr(observers, name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
