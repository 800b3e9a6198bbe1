"""Run the replacer: ``ros2 launch vsensor_ros replacer.launch.py params_file:=replacer.yaml``."""

import os

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

from launch import LaunchContext, LaunchDescription

ARGUMENTS = {  # with default and meaning; None: must be given
    'params_file': (None, 'parameter file, as config/replacer.yaml'),
    'namespace': ('', 'namespace of the node'),
    'name': ('replacer', 'name of the node'),
    'executable': ('replacer', 'replacer, or isolator: it only says who failed'),
    'use_sim_time': ('false', 'follow /clock'),
    'autostart': ('true', 'active at once; false: wait for a lifecycle manager'),
}


def generate_launch_description() -> LaunchDescription:
    """Describe a replacer that is started again when it dies: it comes back in the right state."""
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text)
          for name, (default, text) in ARGUMENTS.items()),
        OpaqueFunction(function=_replacer),
    ])


def _replacer(context: LaunchContext) -> list[LifecycleNode]:
    """Return the node; of a file that is not there launch itself would only warn."""
    given = LaunchConfiguration('params_file').perform(context)
    path = os.path.abspath(os.path.expanduser(given))
    if not os.path.isfile(path):
        raise FileNotFoundError(f'params_file: {given}: there is no file {path}; name one that '
                                'exists')
    return [LifecycleNode(
        package='vsensor_ros', executable=LaunchConfiguration('executable'),
        name=LaunchConfiguration('name'),
        namespace=LaunchConfiguration('namespace'), output='screen',
        parameters=[path, {name: LaunchConfiguration(name)
                           for name in ('use_sim_time', 'autostart')}],
        respawn=True, respawn_delay=1.0)]
