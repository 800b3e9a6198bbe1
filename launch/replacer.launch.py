"""Run the replacer: ``ros2 launch vsensor_ros replacer.launch.py params_file:=replacer.yaml``."""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Describe a replacer that is started again when it dies: it comes back in the right state."""
    arguments = {
        'params_file': ('', 'parameter file, as config/replacer.yaml'),
        'namespace': ('', 'namespace of the node'),
        'use_sim_time': ('false', 'follow /clock'),
        'autostart': ('true', 'active at once; false: wait for a lifecycle manager'),
    }
    return LaunchDescription([
        *(DeclareLaunchArgument(name, default_value=default, description=text) if default or
          name == 'namespace' else DeclareLaunchArgument(name, description=text)
          for name, (default, text) in arguments.items()),
        LifecycleNode(
            package='vsensor_ros', executable='replacer', name='replacer',
            namespace=LaunchConfiguration('namespace'), output='screen',
            parameters=[LaunchConfiguration('params_file'),
                        {name: LaunchConfiguration(name) for name in ('use_sim_time',
                                                                      'autostart')}],
            respawn=True, respawn_delay=1.0),
    ])
